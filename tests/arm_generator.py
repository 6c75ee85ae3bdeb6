"""An arm with a known gap, for tests of the diagnosis.

The diagnosis uses Pinocchio, Gaussian derivatives and tanh. This uses MuJoCo's Newton-Euler recursion on an
analytic motion, and friction as an elastoplastic bristle in time, so that both cannot share a mistake.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import mujoco
import numpy as np
from sim2real.recordings.signals import Commands, Log

from np_control.controller import ControllerConfig
from np_control.dynamics import Dynamics
from np_control.impedance import damping
from np_description.domains import CARD
from np_description.panda import NOMINAL
from np_description.scene import load_model

PERIOD = 0.002
WRIST = np.array([1, 1, 1, 1, 0.2, 0.2, 0.2])


def at(joint: int, value: float) -> np.ndarray:
    """Seven numbers, all zero but that of one joint, counted from 1."""
    array = np.zeros(7)
    array[joint - 1] = value
    return array


def _zero():
    return field(default_factory=lambda: np.zeros(7))


@dataclass(frozen=True, eq=False)
class Truth:
    """What the real arm has besides the nominal one; (7,) or scalars, SI. waviness: Nm of sin(5 q), which no
    catalogue knows; breakaway: rad over which friction builds up; slow: Nm more of it that takes a stroke, rad
    (Dahl); inertia_error: share by which links are harder to turn about their centres; mass_error: by which they are
    heavier, their weight compensated as it is; noise: Nm, a fifth of it
    on the wrist; late: s by which torque is stamped late.
    """

    coulomb_positive: np.ndarray = _zero()
    coulomb_negative: np.ndarray = _zero()
    viscous: np.ndarray = _zero()
    armature: np.ndarray = _zero()
    offset: np.ndarray = _zero()
    waviness: np.ndarray = _zero()
    payload: float = 0.0
    breakaway: float = 1e-4
    slow: np.ndarray = _zero()
    stroke: float = 0.005
    inertia_error: float = 0.0
    mass_error: float = 0.0
    noise: float = 0.02
    late: float = 0.0


class _Rigid:
    """MuJoCo's rigid body dynamics of the arm, rotors apart."""

    def __init__(self, truth: Truth = Truth()):
        self.model = load_model(CARD)
        hand = self.model.body("panda_hand").id
        mass, tip = self.model.body_mass[hand], NOMINAL.frames["hand_tcp"].position
        total, com = mass + truth.payload, self.model.body_ipos[hand].copy()
        self.model.body_ipos[hand] = (mass * com + truth.payload * tip) / total
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, self.model.body_iquat[hand])
        apart = rotation.reshape(3, 3).T @ (tip - com)
        # Two bodies apart: the reduced mass at their distance. The hand's principal axes are kept.
        self.model.body_inertia[hand] += truth.payload * mass / total * (apart @ apart - apart**2)
        self.model.body_mass[hand] = total
        self.model.body_inertia[:] *= (1 + truth.inertia_error) * (1 + truth.mass_error)
        self.model.body_mass[:] *= 1 + truth.mass_error
        self.data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        self._result = np.empty(self.model.nv)

    def torque(self, q, dq, ddq):
        data = self.data
        data.qpos[:7], data.qvel[:], data.qacc[:] = q, 0, 0
        data.qvel[:7], data.qacc[:7] = dq, ddq
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        mujoco.mj_comVel(self.model, data)
        mujoco.mj_rne(self.model, data, 1, self._result)
        return self._result[:7].copy()


def motion(duration: float, seed: int):
    """A function of time: sums of sinusoids (7,) about the ready posture, with derivatives."""
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * rng.uniform(0.08, 0.45, (3, 7))
    phase = rng.uniform(0, 2 * np.pi, (3, 7))
    amplitude = np.array([0.5, 0.35, 0.5, 0.35, 0.5, 0.5, 0.6]) / 2

    def moves(time):
        angle = omega * np.asarray(time)[:, None, None] + phase
        return (
            NOMINAL.ready + amplitude * np.sin(angle).sum(axis=1),
            amplitude * (omega * np.cos(angle)).sum(axis=1),
            -amplitude * (omega**2 * np.sin(angle)).sum(axis=1),
        )

    return moves


def record(
    truth: Truth = Truth(), duration: float = 24.0, seed: int = 0, name: str = "synthetic", noise: int | None = None
) -> Log:
    """A log of this motion, with the commands that the impedance law would have given for it. seed: of the motion; noise: of
    the sensors (None: follows from it)."""
    rng = np.random.default_rng(seed + 1 if noise is None else noise)
    moves = motion(duration, seed)
    time = np.arange(int(duration / PERIOD)) * PERIOD
    q, dq, _ = moves(time)
    middle, speed, acceleration = moves(time - PERIOD / 2 - truth.late)
    arm, compensated = _Rigid(truth), _Rigid(Truth(mass_error=truth.mass_error))
    level = [NOMINAL.frictionloss + truth.coulomb_negative, NOMINAL.frictionloss + truth.coulomb_positive]
    torque, bristle, bend, last = np.empty_like(q), np.zeros(7), np.zeros(7), middle[0]
    for i in range(len(time)):
        bristle = np.clip(bristle + np.maximum(*level) / truth.breakaway * (middle[i] - last), -level[0], level[1])
        moved = middle[i] - last
        bend += (moved - np.abs(moved) * bend) / truth.stroke
        last = middle[i]
        rigid = arm.torque(middle[i], speed[i], acceleration[i]) - compensated.torque(middle[i], 0, 0)
        torque[i] = rigid + bristle + truth.slow * bend
    torque += (NOMINAL.armature + truth.armature) * acceleration + (NOMINAL.damping + truth.viscous) * speed
    torque += truth.offset + truth.waviness * np.sin(5 * middle)
    commands = _commands(time, q, dq, torque, _fed(duration, seed))
    torque = torque + truth.noise * WRIST * (0.5 * coloured(rng, torque.shape, 0.05) + rng.normal(size=torque.shape))
    return Log(name, time, q, dq, torque, time - PERIOD / 2, False, commands)


@cache
def _fed(duration: float, seed: int) -> np.ndarray:
    """Torque (n, 7) that the law feeds forward in this motion: the same whatever the arm is."""
    time, dynamics = np.arange(int(duration / PERIOD)) * PERIOD, Dynamics()
    q, dq, _ = motion(duration, seed)(time)
    rate = np.gradient(dq, time, axis=0)
    return np.array([dynamics.coriolis(*s) + dynamics.mass_matrix(s[0]) @ a for s, a in zip(zip(q, dq), rate)])


def _commands(time, q, dq, torque, fed) -> Commands:
    """Targets for which the law, with the controller's own gains, asks for the torque of the next row."""
    config = ControllerConfig()
    kd = damping(config.stiffness, np.full(7, config.damping_ratio))
    asked = np.vstack([torque[1:], torque[-1:]])
    target = q + (asked - fed + kd * dq) / config.stiffness - kd / config.stiffness * dq
    stiffness = np.tile(config.stiffness, (len(time), 1))
    return Commands(np.arange(len(time)), target, dq, asked, time + PERIOD / 2, stiffness, np.tile(kd, (len(time), 1)))


def coloured(rng: np.random.Generator, shape: tuple[int, int], seconds: float) -> np.ndarray:
    """First-order noise of unit variance and this correlation time."""
    decay = np.exp(-PERIOD / seconds)
    noise = rng.normal(size=shape) * np.sqrt(1 - decay**2)
    for i in range(1, shape[0]):
        noise[i] += decay * noise[i - 1]
    return noise
