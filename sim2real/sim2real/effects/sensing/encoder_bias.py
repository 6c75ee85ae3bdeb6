"""An encoder that reads a constant too much. Shows in every joint that bears weight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from np_description.panda import NOMINAL
from sim2real.effects.background import WEIGHT_KNOWN
from sim2real.effects.behaviour import OnSensors, SensorSlot, Values
from sim2real.effects.evidence import Context
from sim2real.effects.panda_changes import rows
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import Parameter, Signature
from sim2real.effects.stage import Stage
from sim2real.effects.weight import Weight

BIAS = Quantity("bias", "rad", -0.04, 0.04)


def _signatures(context: Context) -> list[Signature]:
    """Effects of the arm, each at the joint whose encoder it is."""
    return [
        Signature(
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


def _compensated_beside(weight: Weight, component: str, values: Mapping[str, float]) -> Weight:
    bias = weight.bias.copy()
    bias[rows(NOMINAL, component)] += values["bias"]
    return replace(weight, bias=bias)


def _read(values: Values):
    bias = values("bias")

    def sense(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return q + bias, dq, torque

    return sense


RECORD = EffectRecord(
    "encoder_bias",
    Place.JOINT,
    (BIAS,),
    _signatures,
    Visible("rad", (0.002, 0.0015, 0.003, 0.003, 0.003, 0.003, 0.003), (2, 3, 4)),
    weight=_compensated_beside,
    sensors=OnSensors(SensorSlot.ZERO, _read),
    said="the encoder of {at} reads {bias:mrad too_much/too_little}",
)
