"""The controller's damping is not the requested one. The controller's own: no simulated arm carries it."""

from __future__ import annotations

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.software.stiffness_gain_error import LAW, lead
from sim2real.effects.stage import Stage

RELATIVE = Quantity("relative", "1", -0.9, 3.0)


def _regressors(context: Context) -> list[EffectRegressor]:
    if context.drive is None:
        return []
    change = (Parameter("relative", "1", RELATIVE.lower, RELATIVE.upper, 0.1, least=0.003),)
    right = {Stage.CONTROLLER: lambda c, j: stack(-c.drive.damping[:, j] * c.drive.velocity[:, j])}
    wrong = {Stage.CONTROLLER: lambda c, j: stack(lead(c, j) - c.drive.damping[:, j] * c.drive.velocity[:, j])}
    return [
        EffectRegressor("damping_gain_error", change, right, LAW),
        EffectRegressor("damping_gain_error", change, wrong, LAW, "lead with the wrong gain"),
    ]


EFFECT = Effect(
    "damping_gain_error",
    EffectTarget.JOINT,
    (RELATIVE,),
    _regressors,
    DetectionLimit("1", (0.02,) * 7, (1, 2, 3, 4, 5, 6, 7)),
    sentence_template="the controller damps {at} {relative:% more/less} than requested",
)
