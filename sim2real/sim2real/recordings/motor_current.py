"""Motor current as joint torque, where the torque constant, Nm/A, is unknown.

The arm's own weight and inertia determine it: a current is the rigid body's torque over the constant, with friction, damping and an
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


def apply_torque_constants(log: Log, per_ampere: Sequence[float]) -> Log:
    """Motor currents as torques by known constants (k,) Nm/A at the joints. Raises ValueError for constants that cannot be."""
    constants = np.asarray(per_ampere, dtype=float)
    if constants.shape != log.torque.shape[1:] or not (np.isfinite(constants) & (constants > 0)).all():
        raise ValueError(
            f"{log.name}: expected {log.torque.shape[1]} torque constants above 0 Nm/A, got {constants.tolist()}"
        )
    return replace(mark_as_current(log), torque=log.torque * constants, is_current=False)


def estimate_torque_constants(logs: Sequence[Log], arm: Arm) -> np.ndarray:
    """Nm/A (k,) at the joint by which motor currents of these logs are torques of this arm; NaN for joints whose load or
    motion is too small to determine it.

    Raises ValueError where no joint determines its constant, and for a joint whose current falls where the torque grows.
    """
    samples, unknown = sample_logs(list(logs)), {}
    load = rigid.inverse_dynamics(arm, samples.position, samples.velocity, samples.acceleration)
    load = load + samples.acceleration * arm.armature
    constants = np.full(len(arm), np.nan)
    for j, joint in enumerate(arm.joints):
        speed = samples.velocity[:, j]
        slides = np.abs(speed) > THRESHOLDS.rows.standstill
        others = samples.filter_function(j, lambda q, v: smooth_sign(v)), speed, np.ones_like(speed)
        columns = np.column_stack([load[:, j], *others])[slides]
        if len(columns) < CURRENT.rows:
            unknown[joint] = "too little motion"
            continue
        current = samples.torque[slides, j]
        values = np.linalg.lstsq(columns, current, rcond=None)[0]
        left = current - columns @ values
        inverse = np.linalg.pinv(columns.T @ columns)[0, 0]
        error = np.sqrt(inverse * (left @ left) / len(left))
        if abs(values[0]) < error / CURRENT.sure:
            unknown[joint] = "too little load"
        elif values[0] < 0:
            raise ValueError(
                f"current of {joint}: expected one that grows with the torque, found the reverse: wrong sign?"
            )
        else:
            constants[j] = 1 / values[0]
    if np.isnan(constants).all():
        raise ValueError(
            "current: expected motion that determines a torque constant, found "
            f"{', '.join(f'{why} ({joint})' for joint, why in unknown.items())}: record more, or give torque_per_ampere"
        )
    return constants


def current_to_torque(log: Log, per_ampere: np.ndarray) -> Log:
    """A log of currents, or one that was, with torques by these constants (k,) Nm/A; 0 Nm where a constant is unknown (NaN)."""
    before = 1.0 if log.is_current else log.per_ampere
    factor = np.nan_to_num(per_ampere / before)
    return replace(log, torque=log.torque * factor, is_current=False, per_ampere=per_ampere)
