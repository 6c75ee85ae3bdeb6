"""Elastic joint: the gear yields to the load. No simulated arm has the motor's side, so none carries it."""

from __future__ import annotations

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

COMPLIANCE = Quantity("compliance", "rad/Nm", 0.0, 0.01)
DAMPING_TIME = Quantity("damping_time", "s", -1e-5, 1e-5)


def _regressors(context: Context) -> list[EffectRegressor]:
    if context.transmission is None:
        return []
    return [
        EffectRegressor(
            "joint_elasticity",
            (
                Parameter("compliance", "rad/Nm", COMPLIANCE.lower, COMPLIANCE.upper, 3e-4),
                Parameter("damping_time", "s", DAMPING_TIME.lower, DAMPING_TIME.upper, 1e-7),
            ),
            {Stage.TRANSMISSION: lambda c, j: stack(c.transmission.load[:, j], c.transmission.load_rate[:, j])},
            "tau = K (motor - joint) + D (motor rate - joint rate)",
        )
    ]


EFFECT = Effect(
    "joint_elasticity",
    EffectTarget.JOINT,
    (COMPLIANCE, DAMPING_TIME),
    _regressors,
    DetectionLimit("rad/Nm", (4e-5, 4e-5, 4e-5, 4e-5, 8e-5, 8e-5, 8e-5), (1, 2, 3, 4, 5, 6, 7)),
    sentence_template="the gear of {at} yields to its load by {compliance:mrad/Nm}",
)
