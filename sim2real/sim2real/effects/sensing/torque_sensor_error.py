"""A torque sensor with a wrong gain or zero. Shows between command and measurement only, not in the motion."""

from __future__ import annotations

import numpy as np

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import HookContext, SensorHook, SensorSlot
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

GAIN, OFFSET = Quantity("gain", "1", -0.5, 0.5), Quantity("offset", "Nm", -5.0, 5.0)


def _regressors(context: Context) -> list[EffectRegressor]:
    if context.drive is None:
        return []
    gain = Parameter("gain", "1", GAIN.lower, GAIN.upper, 0.03)
    offset = Parameter("offset", "Nm", OFFSET.lower, OFFSET.upper, 0.3)
    constant = {Stage.DRIVE: lambda c, j: np.ones((len(c.drive.time), 1))}
    both = {
        Stage.DRIVE: lambda c, j: stack(c.drive.commanded[:, j] + c.drive.gravity[:, j], np.ones(len(c.drive.time)))
    }
    return [
        EffectRegressor("torque_sensor_error", (offset,), constant, "y = tau + offset", "offset only"),
        EffectRegressor("torque_sensor_error", (gain, offset), both, "y = (1 + gain) tau + offset"),
    ]


def _scale_reading(values: HookContext):
    gain, zero = 1 + values("gain"), values("offset")

    def sense(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return q, dq, gain * torque + zero

    return sense


EFFECT = Effect(
    "torque_sensor_error",
    EffectTarget.JOINT,
    (GAIN, OFFSET),
    _regressors,
    DetectionLimit("Nm", (0.06, 0.06, 0.05, 0.05, 0.02, 0.02, 0.015), (1, 2, 3, 4, 5, 6, 7)),
    sensors=SensorHook(SensorSlot.TORQUE, _scale_reading),
    shows_in_motion=False,
    sentence_template="the torque sensor of {at} is off by {gain:%} of its reading and {offset:Nm}",
)
