"""An arm of six hinges with a known gap: MuJoCo's own dynamics on an analytic motion, friction as a bristle in time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

ARMS = Path(__file__).resolve().parents[1] / "examples" / "arms"
MJCF, URDF = ARMS / "six_hinges.xml", ARMS / "six_hinges.urdf"
RATE = 1000  # Hz at which everything is made
BREAKAWAY = 1e-4  # rad over which friction builds up
CENTRE = np.array([0.2, -0.9, 1.2, -0.5, 0.4, 0.3])
AMPLITUDE = np.array([0.5, 0.35, 0.45, 0.5, 0.5, 0.6]) / 2
ANGLE_NOISE, SPEED_NOISE = 2e-5, 1e-3  # rad, rad/s, of encoders where they are not perfect
NOISE = np.array([0.05, 0.05, 0.05, 0.02, 0.02, 0.02])
PER_AMPERE = np.array([11.0, 12.0, 10.5, 7.5, 8.0, 7.0])


@dataclass(frozen=True)
class Truth:
    """What the real arm has besides the nominal one: friction Nm by joint number, damping Nms/rad likewise, payload kg at the
    tool; error: share by which the links are heavier, which no diagnosis is given; rotors: whether it has the
    model's, which a URDF cannot state."""

    friction: tuple[tuple[int, float], ...] = ()
    damping: tuple[tuple[int, float], ...] = ()
    payload: float = 0.0
    error: float = 0.0
    rotors: bool = True


def motion(time: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles, speeds and accelerations (n, 6): sums of sinusoids about one posture."""
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * rng.uniform(0.08, 0.45, (3, 6))
    angle = omega * time[:, None, None] + rng.uniform(0, 2 * np.pi, (3, 6))
    return (
        CENTRE + AMPLITUDE * np.sin(angle).sum(axis=1),
        AMPLITUDE * (omega * np.cos(angle)).sum(axis=1),
        -AMPLITUDE * (omega**2 * np.sin(angle)).sum(axis=1),
    )


def record(
    truth: Truth = Truth(),
    rate: int = RATE,
    duration: float = 30.0,
    seed: int = 0,
    noise: int = 1,
    current: bool = False,
    silent: bool = False,
    encoders: bool = False,
) -> dict[str, np.ndarray]:
    """Arrays of an .npz file: measured torque with gravity, or motor current; seed: of the motion; noise: of the sensors
    (silent: none); encoders:
    whether angles and speeds have noise too."""
    time, q, dq, torque = (values.copy() for values in _moved(truth, duration, seed))
    torque += (not silent) * NOISE * np.random.default_rng(noise).normal(size=torque.shape)
    if encoders:
        sensed = np.random.default_rng(noise + 1000)
        q, dq = q + ANGLE_NOISE * sensed.normal(size=q.shape), dq + SPEED_NOISE * sensed.normal(size=q.shape)
    rows = slice(None, None, RATE // rate)
    measured = {"current_A": torque / PER_AMPERE} if current else {"tau_J_Nm": torque}
    return {name: values[rows] for name, values in {"t_s": time, "q_rad": q, "dq_rad_s": dq, **measured}.items()}


@cache
def _moved(truth: Truth, duration: float, seed: int) -> tuple[np.ndarray, ...]:
    """Time s, angles, speeds and torque (n, 6) without noise; the same motion is asked for at many rates."""
    arm = _built(truth.payload)
    level, damping = arm.dof_frictionloss.copy(), arm.dof_damping.copy().ravel()
    for values, changes in ((level, truth.friction), (damping, truth.damping)):
        for joint, change in changes:
            values[joint - 1] += change
    arm.body_mass *= 1 + truth.error
    arm.body_inertia *= 1 + truth.error
    arm.dof_armature *= truth.rotors
    time = np.arange(int(duration * RATE)) / RATE
    q, dq, ddq = motion(time, seed)
    data, rigid, torque = mujoco.MjData(arm), np.empty(6), np.empty_like(q)
    bristle, before = np.zeros(6), q[0]
    for i in range(len(time)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[i], dq[i], ddq[i]
        mujoco.mj_kinematics(arm, data)
        mujoco.mj_comPos(arm, data)
        mujoco.mj_comVel(arm, data)
        mujoco.mj_rne(arm, data, 1, rigid)
        bristle = np.clip(bristle + level / BREAKAWAY * (q[i] - before), -level, level)
        before = q[i]
        torque[i] = rigid + bristle
    return time, q, dq, torque + (arm.dof_armature * ddq + damping * dq)


def _built(payload: float) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_file(str(MJCF))
    if payload:
        tool = spec.site("tool").pos.copy()
        point = {"mass": payload, "ipos": np.zeros(3), "inertia": [1e-9] * 3, "explicitinertial": True}
        spec.body("wrist_3_link").add_body(pos=tool, **point)
    return spec.compile()
