"""The controller's stiffness is not the one that was asked for. The controller's own: no simulated arm carries it."""

from __future__ import annotations

import numpy as np

from sim2real.effects.evidence import Context
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import Parameter, Signature, stack
from sim2real.effects.stage import Stage

RELATIVE = Quantity("relative", "1", -0.9, 3.0)
LAW = "tau = kp (q_d - q) - kd dq"


def lead(c: Context, j: int) -> np.ndarray:
    """Torque (n,) Nm of the law by which the target is ahead: kd/kp of its velocity. With the wrong gain it is another one."""
    return c.drive.damping[:, j] * c.drive.target_velocity[:, j]


def _signatures(context: Context) -> list[Signature]:
    if context.drive is None:
        return []
    change = (Parameter("relative", "1", RELATIVE.lower, RELATIVE.upper, 0.1, least=0.003),)
    right = {Stage.CONTROLLER: lambda c, j: stack(c.drive.stiffness[:, j] * c.drive.error[:, j])}
    wrong = {Stage.CONTROLLER: lambda c, j: stack(c.drive.stiffness[:, j] * c.drive.error[:, j] - lead(c, j))}
    return [
        Signature("stiffness_gain_error", change, right, LAW),
        Signature("stiffness_gain_error", change, wrong, LAW, "lead with the wrong gain"),
    ]


RECORD = EffectRecord(
    "stiffness_gain_error",
    Place.JOINT,
    (RELATIVE,),
    _signatures,
    Visible("1", (0.01,) * 7, (1, 2, 3, 4, 5, 6, 7)),
    said="the controller holds {at} {relative:% stiffer/softer} than it was asked to",
)
