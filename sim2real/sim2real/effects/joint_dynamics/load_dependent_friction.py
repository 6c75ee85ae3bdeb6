"""Friction proportional to the load through the gear."""

from __future__ import annotations

import numpy as np

from np_description.panda import NOMINAL
from sim2real.effects.background import WEIGHT_KNOWN
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import HookContext, ResistanceFunction, smooth_direction
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

COEFFICIENT = Quantity("coefficient", "1", 0.0, 0.5)


def _regressors(context: Context) -> list[EffectRegressor]:
    return [
        EffectRegressor(
            "load_dependent_friction",
            (Parameter("coefficient", "1", COEFFICIENT.lower, COEFFICIENT.upper, 0.05),),
            {Stage.DYNAMICS: lambda c, j: stack(np.abs(c.prediction.load[:, j]) * c.prediction.direction[:, j])},
            "friction proportional to the load through the gear",
            model=WEIGHT_KNOWN,
        )
    ]


def _load_torque(values: HookContext) -> ResistanceFunction:
    coefficient, hold = values("coefficient"), values.arrays.hold(NOMINAL)
    return lambda q, dq: coefficient * abs(hold(q)) * smooth_direction(dq)


EFFECT = Effect(
    "load_dependent_friction",
    EffectTarget.JOINT,
    (COEFFICIENT,),
    _regressors,
    DetectionLimit("1", (0.02, 0.004, 0.008, 0.004, 0.02, 0.015, 0.03), (2, 3, 4, 6), largest=8),
    joints=_load_torque,
    sentence_template="{at} has dry friction that is {coefficient:%} of its load",
)
