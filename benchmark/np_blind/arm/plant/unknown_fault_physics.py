"""The physics of the faults that are in no catalogue (out_of_catalogue.py), as they act on the arms."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from np_blind.arm.plant.physics import Physics
from np_blind.arm.plant.unknown_fault_physics_wide import WideUnknownFaultPhysics
from np_description.panda import NOMINAL

MOVING = 0.005  # rad/s, beyond which grease does not set
FORGETS = 0.05  # s, in which motion makes it thin again
DROPOUT, DROPOUT_EVERY = 0.06, 1.5  # s that a drive gives way for, s between on average
BRAKE_STAYS = 6.0  # s that a brake drags, or does not, on average


class UnknownFaultPhysics:
    """State and torques of the faults out of the catalogue of B arms; all arrays (B, 7).

    used: what of `physics` is not its default; q: where the links begin; period, step: s.
    """

    def __init__(
        self,
        physics: Physics,
        used: Collection[str],
        rng: Sequence[np.random.Generator],
        q: np.ndarray,
        period: float,
        step: float,
    ):
        self._physics, self._used, self._rng, self._period, self._step = physics, used, rng, period, step
        self._rest, self._dropped = np.zeros_like(q), np.zeros_like(q)
        self._drags = np.zeros(q.shape, dtype=bool)
        self._part_angle, self._part_speed = q.copy(), np.zeros_like(q)  # of the loose part
        self._bent = np.zeros_like(q)  # rad, the dress pack
        self._wide = WideUnknownFaultPhysics(physics, used, q, step)

    def begin_period(self) -> None:
        """What chance decides in a control period."""
        if "dropout" in self._used:
            begins = self._draw() < self._period / DROPOUT_EVERY
            self._dropped = np.where(begins, DROPOUT, self._dropped - self._period)
        if "brake" in self._used:
            self._drags ^= self._draw() < self._period / BRAKE_STAYS

    def friction(self, q: np.ndarray, speed: np.ndarray) -> np.ndarray | float:
        """Coulomb level on top of the joint's own, Nm."""
        p, used, level = self._physics, self._used, 0.0
        if "rub" in used:
            level = level + p.rub * np.exp(-(((q - p.rub_angle) / p.rub_width) ** 2))
        if "wavy" in used:
            level = level + p.wavy * (1.0 + np.sin(p.wavy_order * q + p.wavy_phase))
        if "ageing" in used:
            moving = np.abs(speed) > MOVING
            self._rest = np.where(moving, self._rest * np.exp(-self._step / FORGETS), self._rest + self._step)
            level = level + p.ageing * (1.0 - np.exp(-self._rest / p.ageing_time))
        if "brake" in used:
            level = level + p.brake * self._drags
        return level + self._wide.friction(speed)

    def given(self, wanted: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """What amplifiers give at a command of `wanted` Nm, gravity compensation included, at the rotors' speed."""
        wanted = self._wide.given(wanted, speed)
        if "dead_zone" not in self._used:
            return wanted
        return np.copysign(np.maximum(np.abs(wanted) - self._physics.dead_zone, 0.0), wanted)

    def drive_scale(self, scale: np.ndarray, time: float, theta: np.ndarray) -> np.ndarray:
        """Torque scale of the drives whose own is `scale` and whose rotors are at theta."""
        p, used = self._physics, self._used
        if "flutter" in used:
            scale = scale + p.flutter * np.sin(2 * np.pi * p.flutter_frequency * time)
        if "fading" in used:
            scale = scale * (1.0 - p.fading * (1.0 - np.exp(-time / p.fading_time)))
        if "commutation" in used:
            scale = scale * (1.0 + p.commutation * np.sin(p.commutation_order * theta + p.commutation_phase))
        if "dropout" in used:
            scale = scale * (1.0 - p.dropout * (self._dropped > 0))
        return scale

    def link_torque(self, q: np.ndarray, dq: np.ndarray, time: float) -> np.ndarray | float:
        """What resists on the links, Nm."""
        p, used, torque = self._physics, self._used, self._wide.link_torque(q)
        if "cubic" in used:
            torque = torque + p.cubic * (q - NOMINAL.ready) ** 3
        if "shake" in used:
            torque = torque + p.shake * np.sin(2 * np.pi * p.shake_frequency * time + p.shake_phase)
        if "coupling" in used:
            torque = torque + np.matmul(p.coupling, dq[:, :, None])[:, :, 0]
        if "taut" in used:
            torque = torque + p.taut * np.maximum(p.taut_side * (q - p.taut_angle), 0.0) * p.taut_side
        if "dent" in used:
            off = (q - p.dent_angle) / p.dent_width
            torque = torque + p.dent * off * np.exp(0.5 * (1.0 - off**2))  # `dent` at a width from its middle
        if "part_inertia" in used:
            torque = torque + self._loose_part(q, dq)
        if "wander" in used:
            torque = torque + p.wander * np.sin(2 * np.pi * time / p.wander_time)
        if "grease" in used:
            torque = torque + p.grease * dq / (p.grease_speed + np.abs(dq))
        if "pack" in used:
            self._bent = np.minimum(np.maximum(self._bent + self._step * dq, -p.pack_stroke), p.pack_stroke)
            torque = torque + p.pack * self._bent / p.pack_stroke
        return torque

    def _loose_part(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Torque of a spring and damper between link and part, which moves on by a step."""
        p = self._physics
        natural = 2 * np.pi * p.part_frequency
        twist, rate = q - self._part_angle, dq - self._part_speed
        per_inertia = natural**2 * twist + 2 * p.part_damping * natural * rate
        self._part_speed = self._part_speed + self._step * per_inertia
        self._part_angle = self._part_angle + self._step * self._part_speed
        return p.part_inertia * per_inertia

    def _draw(self) -> np.ndarray:
        return np.array([rng.random(self._drags.shape[1]) for rng in self._rng])


def eccentric_encoder_error(physics: Physics, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What link encoders (B, 7) with a disc off its centre show too much at q: rad, and share of the speed."""
    angle = q + physics.eccentric_phase
    return physics.eccentric * np.sin(angle), physics.eccentric * np.cos(angle)


def encoder_slip(physics: Physics, time: float) -> np.ndarray:
    """What link encoders (B, 7) show too much, rad, once their discs have slipped on their shafts."""
    return physics.slip * (time >= physics.slip_time)
