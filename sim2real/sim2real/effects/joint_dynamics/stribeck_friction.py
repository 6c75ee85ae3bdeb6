"""Stribeck friction: more of it near standstill."""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import HookContext, ResistanceFunction, smooth_direction
from sim2real.effects.recurrences import smooth_sign
from sim2real.effects.regressor import EffectRegressor, NonlinearParameter, Parameter, stack
from sim2real.effects.stage import Stage

BREAKAWAY, SPEED = Quantity("breakaway", "Nm", 0.0, 2.0), Quantity("speed", "rad/s", 0.0, 1.0)
SPEEDS = tuple(0.03 * 1.4**n for n in range(7))  # rad/s: so fine that the best one leaves nothing to other effects


def _regressor(speed: float) -> EffectRegressor:
    return EffectRegressor(
        "stribeck_friction",
        (Parameter("breakaway", "Nm", BREAKAWAY.lower, BREAKAWAY.upper, 0.2),),
        {
            Stage.DYNAMICS: lambda c, j: stack(
                c.samples.filter_function(j, lambda q, v: smooth_sign(v) * np.exp(-((v / speed) ** 2))),
            )
        },
        "Armstrong-Helouvry et al., Automatica 1994",
        f"{speed:.3g} rad/s",
        NonlinearParameter("speed", "rad/s", speed, _regressor),
    )


def _regressors(context: Context) -> list[EffectRegressor]:
    return [_regressor(speed) for speed in SPEEDS]


def _stribeck_torque(values: HookContext) -> ResistanceFunction:
    breakaway, speed = values("breakaway"), values("speed").clip(1e-3)
    return lambda q, dq: breakaway * smooth_direction(dq) * namespace(dq).exp(-((dq / speed) ** 2))


EFFECT = Effect(
    "stribeck_friction",
    EffectTarget.JOINT,
    (BREAKAWAY, SPEED),
    _regressors,
    DetectionLimit("Nm", (0.08, 0.08, 0.07, 0.07, 0.03, 0.03, 0.02), (1, 2, 3, 4, 5, 6, 7), largest=6),
    joints=_stribeck_torque,
    sentence_template="{at} has {breakaway:Nm} of further friction near standstill, below about {speed:rad/s}",
)
