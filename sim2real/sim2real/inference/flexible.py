"""The flexible model, without physical meaning: what a smooth unknown mechanism would need.

Harmonics of the joint's angle, alone and signed by the direction of motion, powers of velocity and of torque, and the
motion of the other joints.
"""

from __future__ import annotations

import numpy as np

from sim2real.effects.evidence import Context
from sim2real.effects.stage import Stage
from sim2real.thresholds import THRESHOLDS

OMNIBUS = THRESHOLDS.omnibus


def flexible_columns(context: Context, stage: Stage, joint: int, expected: bool = False) -> np.ndarray:
    """Columns (n, count) of the flexible model at a stage of a joint; of the transmission, none.

    expected: with the torque that the nominal arm or law would have, in place of that recorded. The recorded one holds the
    residual itself.
    """
    j = joint
    if stage is Stage.TRANSMISSION:
        return np.zeros((len(context.transmission.time), 0))
    if stage is Stage.DYNAMICS:
        s, p = context.samples, context.prediction
        q, v, direction = s.position[:, j], s.velocity[:, j], p.direction[:, j]
        others = [s.velocity[:, k] for k in range(len(context.arm)) if k != j]
        others += [s.acceleration[:, k] for k in range(len(context.arm)) if k != j]
        torque = p.total[:, j] if expected else s.torque[:, j]
    else:
        d = context.drive
        v, torque = d.velocity[:, j], (d.law if expected and stage is Stage.CONTROLLER else d.commanded)[:, j]
        direction = np.tanh(v / OMNIBUS.direction_speed)
        others = [np.gradient(d.commanded[:, j])]
        q = np.zeros_like(v)
    columns = [np.ones_like(v), direction, v, v * np.abs(v), v**3, np.abs(v), direction * np.abs(torque), *others]
    columns += [torque, np.abs(torque), torque * np.abs(torque), torque**3]
    if stage is Stage.DYNAMICS:
        for k in range(1, OMNIBUS.harmonics + 1):
            columns += [np.sin(k * q), np.cos(k * q), direction * np.sin(k * q), direction * np.cos(k * q)]
    return np.array(columns).T
