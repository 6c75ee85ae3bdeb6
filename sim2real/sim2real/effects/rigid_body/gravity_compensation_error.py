"""Gravity compensation that is too strong or too weak."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from sim2real.effects.background import WEIGHT_KNOWN
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.gravity import GravityModel
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

SCALE = Quantity("scale", "1", -0.3, 0.3)


def _regressors(context: Context) -> list[EffectRegressor]:
    return [
        EffectRegressor(
            "gravity_compensation_error",
            (Parameter("scale", "1", SCALE.lower, SCALE.upper, 0.03),),
            {Stage.DYNAMICS: lambda c, j: stack(-c.prediction.gravity[:, j])},
            "scale of the compensated gravity",
            is_arm=True,
            model=WEIGHT_KNOWN,
        )
    ]


def _scale_compensation(weight: GravityModel, component: str, values: Mapping[str, float]) -> GravityModel:
    return replace(weight, share=weight.share + values["scale"])


EFFECT = Effect(
    "gravity_compensation_error",
    EffectTarget.ARM,
    (SCALE,),
    _regressors,
    DetectionLimit("1", 0.005),
    gravity_error=_scale_compensation,
    sentence_template="gravity compensation is {scale:% too_strong/too_weak}",
)
