"""Gain of the torque loop: the drive gives more or less than commanded."""

from __future__ import annotations

from sim2real.effects.background import WEIGHT_KNOWN
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import DriveFunction, DriveHook, DriveSlot, HookContext
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

SCALE = Quantity("scale", "1", -1.0, 2.0)
MOST = 0.5  # that is looked for
KNOWN = 0.005  # to which the torque constant of any drive is known
SOURCE = "gain of the torque loop"


def _regressors(context: Context) -> list[EffectRegressor]:
    if context.constant is not None:
        return []  # a wrong scale cannot be distinguished from an unknown one
    scale = (Parameter("scale", "1", -MOST, MOST, 0.03, least=KNOWN),)
    hidden = {Stage.DYNAMICS: lambda c, j: stack(-c.prediction.load[:, j])}
    found = [EffectRegressor("torque_scale", scale, hidden, SOURCE, "unseen by the sensor", model=WEIGHT_KNOWN)]
    if context.drive is not None:
        total = {Stage.DRIVE: lambda c, j: stack(c.drive.commanded[:, j] + c.drive.gravity[:, j])}
        command_only = {Stage.DRIVE: lambda c, j: stack(c.drive.commanded[:, j])}
        found.append(EffectRegressor("torque_scale", scale, total, SOURCE, model=WEIGHT_KNOWN))
        found.append(EffectRegressor("torque_scale", scale, command_only, SOURCE, "gravity apart"))
    return found


def _scale_torque(values: HookContext) -> DriveFunction:
    gain = 1 + values("scale")
    return lambda torque: gain * torque


EFFECT = Effect(
    "torque_scale",
    EffectTarget.JOINT,
    (SCALE,),
    _regressors,
    DetectionLimit("1", (0.02, 0.01, 0.01, 0.01, 0.02, 0.02, 0.03), (1, 2, 3, 4, 5, 6, 7), largest=8),
    drive=DriveHook(DriveSlot.GAIN, _scale_torque),
    sentence_template="the drive of {at} gives {scale:% more/less} torque than commanded",
)
