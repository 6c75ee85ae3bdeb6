"""The controller's stiffness is not the requested one. The controller's own: no simulated arm carries it."""

from __future__ import annotations

import numpy as np

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

RELATIVE = Quantity("relative", "1", -0.9, 3.0)
LAW = "tau = kp (q_d - q) - kd dq"


def lead(c: Context, j: int) -> np.ndarray:
    """Torque (n,) Nm of the law by which the target is ahead: kd/kp of its velocity. With the wrong gain it is another one."""
    return c.drive.damping[:, j] * c.drive.target_velocity[:, j]


def _regressors(context: Context) -> list[EffectRegressor]:
    if context.drive is None:
        return []
    change = (Parameter("relative", "1", RELATIVE.lower, RELATIVE.upper, 0.1, least=0.003),)
    right = {Stage.CONTROLLER: lambda c, j: stack(c.drive.stiffness[:, j] * c.drive.error[:, j])}
    wrong = {Stage.CONTROLLER: lambda c, j: stack(c.drive.stiffness[:, j] * c.drive.error[:, j] - lead(c, j))}
    return [
        EffectRegressor("stiffness_gain_error", change, right, LAW),
        EffectRegressor("stiffness_gain_error", change, wrong, LAW, "lead with the wrong gain"),
    ]


EFFECT = Effect(
    "stiffness_gain_error",
    EffectTarget.JOINT,
    (RELATIVE,),
    _regressors,
    DetectionLimit("1", (0.01,) * 7, (1, 2, 3, 4, 5, 6, 7)),
    sentence_template="the controller holds {at} {relative:% stiffer/softer} than requested",
)
