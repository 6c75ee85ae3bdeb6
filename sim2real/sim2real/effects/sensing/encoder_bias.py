"""An encoder that reads a constant too much. Shows in every joint that bears weight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from np_description.panda import NOMINAL
from sim2real.effects.background import WEIGHT_KNOWN
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.gravity import GravityModel
from sim2real.effects.hooks import HookContext, SensorHook, SensorSlot
from sim2real.effects.joint_arrays import joint_rows
from sim2real.effects.regressor import EffectRegressor, Parameter
from sim2real.effects.stage import Stage

BIAS = Quantity("bias", "rad", -0.04, 0.04)


def _regressors(context: Context) -> list[EffectRegressor]:
    """Effects of the arm, each at the joint whose encoder it is."""
    return [
        EffectRegressor(
            "encoder_bias",
            (Parameter("bias", "rad", BIAS.lower, BIAS.upper, 0.005),),
            {Stage.DYNAMICS: lambda c, j, k=k: -c.prediction.gravity_slope[:, j, k : k + 1]},
            "gravity torque at q - b, to first order",
            f"joint {k + 1}",
            is_arm=True,
            component=context.arm.joints[k],
            model=WEIGHT_KNOWN,
        )
        for k in range(len(context.arm))
    ]


def _shift_compensation(weight: GravityModel, component: str, values: Mapping[str, float]) -> GravityModel:
    bias = weight.bias.copy()
    bias[joint_rows(NOMINAL, component)] += values["bias"]
    return replace(weight, bias=bias)


def _add_bias(values: HookContext):
    bias = values("bias")

    def sense(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return q + bias, dq, torque

    return sense


EFFECT = Effect(
    "encoder_bias",
    EffectTarget.JOINT,
    (BIAS,),
    _regressors,
    DetectionLimit("rad", (0.002, 0.0015, 0.003, 0.003, 0.003, 0.003, 0.003), (2, 3, 4)),
    gravity_error=_shift_compensation,
    sensors=SensorHook(SensorSlot.ZERO, _add_bias),
    sentence_template="the encoder of {at} reads {bias:mrad too_much/too_little}",
)
