"""Arms with everything that a nominal simulator leaves out: what is behind the torque interface.

The plant is stepped at 2 kHz (semi-implicit Euler) with the rigid-body terms of the middle of each control
period. All arms of a batch move at once; a `Physics` holds the parameters of each.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from np_blind.arm.plant.hysteresis import bouc_wen, lugre, prandtl
from np_blind.arm.plant.physics import CURVE_SPEEDS, Physics
from np_blind.arm.plant.rigid_arm import PANDA, HingedArm, RigidArms
from np_blind.arm.plant.unknown_fault_physics import UnknownFaultPhysics, eccentric_encoder_error, encoder_slip

PERIOD = 0.002  # s, of control
SUBSTEPS = 4
STEP = PERIOD / SUBSTEPS
LONGEST_DELAY = 0.02  # s
LEAST_FRICTION = 0.01  # Nm, however little a patch requests
HOLDS = 0.004  # rad/s, up to which friction is that of standstill


class BatchedArms:
    """B arms in motion. `step` takes the commands of one control period.

    q, dq (B, 7): links; theta, omega (B, 7): motors, the same where the gear is stiff. torque (B, 7) Nm: what
    the drives gave on average over the last period, gravity compensation apart; that is held.
    """

    def __init__(self, physics: Physics, start: np.ndarray, rng: list[np.random.Generator], arm: HingedArm = PANDA):
        arms = len(physics)
        self.physics, self._rng = physics, rng
        self.q = np.tile(np.asarray(start, dtype=float), (arms, 1))
        self.dq, self.theta, self.omega = np.zeros_like(self.q), self.q.copy(), np.zeros_like(self.q)
        self.torque = np.zeros_like(self.q)
        self.time = 0.0
        together = physics.inertials.stacked(arm.inertials(arms)).stacked(physics.compensated)
        self._arms = RigidArms(together, arm.joint_frames)
        self._eye = np.eye(self.q.shape[1])
        self._nominal_rotor = arm.armature * self._eye
        self._flexible = physics.flexible > 0
        self._is_soft = bool(self._flexible.any())
        self._rotor = np.where(self._flexible, 0.0, physics.armature)[:, :, None] * self._eye
        self._rotor = self._rotor + physics.rotor_coupling
        self._used = {item.name for item in fields(physics) if item.metadata and physics.uses(item.name)}
        self._follow = 1.0 - np.exp(-STEP / np.maximum(physics.lag, 1e-9))
        self._stiff = np.minimum(physics.coulomb_forward, physics.coulomb_backward) / physics.breakaway
        self._bend, self._lugre, self._hysteresis = (np.zeros_like(self.q) for _ in range(3))
        self._drive, self._load, self._limited = (np.zeros_like(self.q) for _ in range(3))
        self._out_of_catalogue = UnknownFaultPhysics(physics, self._used, rng, self.q, PERIOD, STEP)
        length = int(round(LONGEST_DELAY / PERIOD)) + 2
        self._history = np.zeros((length, *self.q.shape))
        self._number = 0
        # How many periods ago the command in force at the end of each substep was given, and for which share
        # of the substep it had been.
        ends = (np.arange(1, SUBSTEPS + 1)[:, None] * STEP - physics.command_delay) / PERIOD
        newest = np.ceil(ends - 1e-9) - 1
        self._ago = -newest.astype(int)
        self._share = np.clip((ends - newest) * SUBSTEPS, 0.0, 1.0)[:, :, None]
        self._is_whole = (self._share == 1.0).all(axis=(1, 2))
        self._rows = np.arange(arms)

    def begin(self, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nominal mass matrix (B, 7, 7), rotors included, and Coriolis torque (B, 7) at a measured state.

        To be called before each `step`, whose own terms, in the middle of the period to come, are found in
        the same pass: the arm's true ones, and the gravity that the drives compensate.
        """
        arms = len(self.physics)
        middle = self.q + 0.5 * PERIOD * self.dq
        shown = (
            middle
            + self.physics.encoder_bias
            + eccentric_encoder_error(self.physics, middle)[0]
            + encoder_slip(self.physics, self.time)
        )
        matrix, velocity, weight = self._arms.terms(
            np.concatenate([middle, q, shown]), np.concatenate([self.dq, dq, self.dq])
        )
        self._inverse = np.linalg.inv(matrix[:arms] + self._rotor)
        self._velocity_torque, self._weight = velocity[:arms], weight[:arms]
        self.held = (1.0 + self.physics.gravity_scale) * weight[2 * arms :]
        return matrix[arms : 2 * arms] + self._nominal_rotor, velocity[arms : 2 * arms]

    def step(self, command: np.ndarray) -> np.ndarray:
        """One control period with the commands (B, 7) Nm, without gravity; those that arrived."""
        p = self.physics
        self._number += 1
        arrived = self._received(command)
        self._history[self._number % len(self._history)] = arrived
        held = self.held
        self._out_of_catalogue.begin_period()
        noise = self._drive_noise()
        total = np.zeros_like(self.q)
        # A stiff gear carries the motor's torque, a flexible one what it is wound up by.
        for s in range(SUBSTEPS):
            drive = self._driven(self._in_force(s), held) + noise
            total += drive
            resisting = self._resisting(drive)
            net = drive - resisting
            against = self._velocity_torque + self._weight + self._link_torque()
            self._load = self._through_gear(net, against) if self._is_soft else net
            self.dq = self.dq + STEP * _times(self._inverse, self._load - against)
            self.q = self.q + STEP * self.dq
            if self._is_soft:
                self._move_rotors(net)
            else:
                self.theta, self.omega = self.q, self.dq
            self.time += STEP
        self.torque = (1.0 + p.sensor_scale) * (total / SUBSTEPS) + p.sensor_bias - held
        return arrived

    # The drive

    def _drive_noise(self) -> np.ndarray | float:
        if "drive_noise" not in self._used:
            return 0.0
        return self.physics.drive_noise[:, None] * np.array([rng.normal(size=len(self._eye)) for rng in self._rng])

    def _received(self, command: np.ndarray) -> np.ndarray:
        if "loss" not in self._used:
            return command
        lost = np.array([rng.random() for rng in self._rng]) < self.physics.loss
        before = self._history[(self._number - 1) % len(self._history)]
        return np.where(lost[:, None], before, command)

    def _in_force(self, s: int) -> np.ndarray:
        """Commands (B, 7) that act in substep `s`, on average over it."""
        length, share = len(self._history), self._share[s]
        at = (self._number - self._ago[s]) % length
        newest = self._history[at, self._rows]
        if self._is_whole[s]:
            return newest
        before = self._history[at - 1, self._rows]
        return before + share * (newest - before)

    def _driven(self, command: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Torque (B, 7) of the drives, gravity compensation included."""
        p = self.physics
        wanted = self._drive + self._follow * (command - self._drive) if "lag" in self._used else command
        weight = p.with_weight * held
        wanted = wanted + weight
        if "rate_limit" in self._used:
            largest = p.rate_limit * STEP
            wanted = np.minimum(np.maximum(wanted, self._limited - largest), self._limited + largest)
        if "saturation" in self._used:
            wanted = np.minimum(np.maximum(wanted, -p.saturation), p.saturation)
        self._limited = wanted
        wanted = self._drive = wanted - weight
        scale = self._out_of_catalogue.drive_scale(1.0 + p.torque_scale, self.time, self.theta)
        return scale * self._out_of_catalogue.given(wanted + held, self.omega)

    # Friction, and what else resists on the motor's side

    def _resisting(self, drive: np.ndarray) -> np.ndarray:
        p, used, speed = self.physics, self._used, self.omega
        forward, backward = p.coulomb_forward, p.coulomb_backward
        extra = 0.0
        if "stribeck_level" in used:
            extra = extra + p.stribeck_level * np.exp(-((speed / p.stribeck_speed) ** 2))
        if "load_coefficient" in used:
            extra = extra + p.load_coefficient * np.abs(self._load)
        if "uneven" in used:
            extra = extra + p.uneven * forward * np.sin(p.uneven_order * self.q + p.uneven_phase)
        if "holding" in used:
            extra = extra + p.holding * forward * np.exp(-((speed / HOLDS) ** 2))
        extra = extra + self._out_of_catalogue.friction(self.q, speed)
        forward, backward = forward + extra, backward + extra
        if "fall_forward" in used:
            left = 1.0 / (1.0 + (np.abs(speed) / p.fall_speed) ** p.fall_steepness)
            forward, backward = forward + p.fall_forward * left, backward + p.fall_backward * left
        if "curve_forward" in used or "curve_backward" in used:
            forward, backward = (
                np.maximum(level + _interpolate(curve, np.abs(speed)), LEAST_FRICTION)
                for level, curve in ((forward, p.curve_forward), (backward, p.curve_backward))
            )
        self._bend, friction = prandtl(self._bend, speed, forward, backward, self._stiff, STEP)
        friction = friction + np.where(speed > 0, p.viscous_forward, p.viscous_backward) * speed
        if "thermal_drop" in used:
            friction = friction * (1.0 - p.thermal_drop * (1.0 - np.exp(-self.time / p.thermal_time)))
        if "lugre_level" in used:
            self._lugre, more = lugre(self._lugre, speed, p.lugre_level, p.lugre_stroke, STEP)
            friction = friction + more
        if "ripple" in used:
            friction = friction + p.ripple * np.sin(p.ripple_order * self.theta + p.ripple_phase)
        return friction + p.offset

    # The gear

    def _through_gear(self, net: np.ndarray, against: np.ndarray) -> np.ndarray:
        """Torque (B, 7) on the links: of the gear's spring where it is flexible.

        net: what drives the rotors; against: what resists on the links. The torque is that of the twist and
        its rate at the end of the substep (linearly implicit Euler): the link of the wrist alone, 5e-3 kg m^2
        on a gear of 1e5 Nm/rad, swings faster than an explicit step can follow.
        """
        p = self.physics
        twist, rate = self.theta - self.q, self.omega - self.dq
        outside = np.maximum(np.abs(twist) - p.play, 0.0)
        torque = p.stiffness * np.copysign(outside, twist)
        stiffness = np.where(outside > 0, p.stiffness, 0.0)
        if "hysteresis_torque" in self._used:
            slope = p.hysteresis_torque / p.hysteresis_stroke
            torque = torque + slope * self._hysteresis
            stiffness = stiffness + slope * (1.0 - np.sign(rate) * self._hysteresis / p.hysteresis_stroke)
        gain = np.where(self._flexible, STEP * stiffness + np.where(outside > 0, p.gear_damping, 0.1), 0.0)
        # The rate at the end is that without a gear, less what the torque sought takes from rotors and links.
        pushed = _times(self._inverse, np.where(self._flexible, 0.0, net) - against)
        free = rate + STEP * (net / p.armature - pushed)
        matrix = self._eye + STEP * gain[:, :, None] * (self._inverse + self._eye / p.armature[:, None, :])
        wanted = np.where(self._flexible, torque + gain * free, 0.0)
        torque = np.linalg.solve(matrix, wanted[:, :, None])[:, :, 0]
        return np.where(self._flexible, torque, net)

    def _move_rotors(self, net: np.ndarray) -> None:
        speed = self.omega + STEP * (net - self._load) / self.physics.armature
        self.omega = np.where(self._flexible, speed, self.dq)
        self.theta = np.where(self._flexible, self.theta + STEP * speed, self.q)
        if "hysteresis_torque" in self._used:
            stroke = self.physics.hysteresis_stroke
            self._hysteresis = bouc_wen(self._hysteresis, self.omega - self.dq, stroke, STEP)

    def _link_torque(self) -> np.ndarray:
        """Torque (B, 7) that resists on the links."""
        p, torque = self.physics, self._out_of_catalogue.link_torque(self.q, self.dq, self.time)
        if "cable_stiffness" in self._used:
            torque = torque + p.cable_stiffness * (self.q - p.cable_centre)
        return torque


def _interpolate(curve: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Values (B, 7) of curves (B, 7, k) at speeds (B, 7) rad/s: level below the first of CURVE_SPEEDS, straight on above the last."""
    below = np.clip(np.searchsorted(CURVE_SPEEDS, speed) - 1, 0, len(CURVE_SPEEDS) - 2)
    share = np.maximum((speed - CURVE_SPEEDS[below]) / np.diff(CURVE_SPEEDS)[below], 0.0)
    low, high = (np.take_along_axis(curve, (below + k)[..., None], 2)[..., 0] for k in (0, 1))
    return low + share * (high - low)


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """(B, 7, 7) times (B, 7)."""
    return np.matmul(matrix, vector[:, :, None])[:, :, 0]
