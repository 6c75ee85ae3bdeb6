"""Motor current as joint torque, where nobody knows how many newton metres an ampere makes.

The arm's own weight and inertia tell: a current is the rigid body's torque over the constant, with friction, damping and an
offset of sizes of their own beside it, by least squares, joint by joint. (The constant holds torque constant, gear ratio and
efficiency.) What any effect does to the torque spoils it a little; the diagnosis therefore lets every constant vary
(`inference.nuisances`), and settles it with the effects found (`inference.torque_constants`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim2real.arm import rigid_body as rigid
from sim2real.arm.model import Arm
from sim2real.effects.recurrences import smooth_sign
from sim2real.recordings.signals import Log, sample_logs
from sim2real.thresholds import THRESHOLDS

CURRENT = THRESHOLDS.current


def mark_as_current(log: Log) -> Log:
    """A log whose efforts are motor currents: they hold the arm's weight, and commands in Nm do not go with them."""
    return replace(log, is_current=True, with_gravity=True, commands=None)


def estimate_torque_constants(logs: Sequence[Log], arm: Arm) -> np.ndarray:
    """Nm/A (k,) at the joint by which motor currents of these logs are torques of this arm.

    Raises ValueError naming a joint whose motion does not tell it, or whose current falls where the torque grows.
    """
    samples, found = sample_logs(list(logs)), []
    load = rigid.inverse_dynamics(arm, samples.position, samples.velocity, samples.acceleration)
    load = load + samples.acceleration * arm.armature
    for j, joint in enumerate(arm.joints):
        speed = samples.velocity[:, j]
        slides = np.abs(speed) > THRESHOLDS.rows.standstill
        others = samples.filter_function(j, lambda q, v: smooth_sign(v)), speed, np.ones_like(speed)
        columns = np.column_stack([load[:, j], *others])[slides]
        if len(columns) < CURRENT.rows:
            raise ValueError(_unknown(joint, "too little motion of it"))
        current = samples.torque[slides, j]
        values = np.linalg.lstsq(columns, current, rcond=None)[0]
        left = current - columns @ values
        inverse = np.linalg.pinv(columns.T @ columns)[0, 0]
        error = np.sqrt(inverse * (left @ left) / len(left))
        if abs(values[0]) < error / CURRENT.sure:
            raise ValueError(_unknown(joint, "too little load on it"))
        if values[0] < 0:
            raise ValueError(
                f"current of {joint}: expected one that grows with the torque, found the reverse: wrong sign?"
            )
        found.append(1 / values[0])
    return np.array(found)


def current_to_torque(log: Log, per_ampere: np.ndarray) -> Log:
    """A log of currents, or one that was, with torques by these constants (k,) Nm/A."""
    before = 1.0 if log.is_current else log.per_ampere
    return replace(log, torque=log.torque * (per_ampere / before), is_current=False, per_ampere=per_ampere)


def _unknown(joint: str, why: str) -> str:
    return (
        f"current of {joint}: expected motion that tells its torque constant, found {why}: "
        "record more, or give torque_per_ampere"
    )
