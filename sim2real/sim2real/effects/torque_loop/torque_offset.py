"""Offset of the torque loop: what a drive gives at zero command."""

from __future__ import annotations

import numpy as np

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import DriveFunction, DriveHook, DriveSlot, HookContext
from sim2real.effects.regressor import EffectRegressor, Parameter
from sim2real.effects.stage import Stage

OFFSET = Quantity("offset", "Nm", -50.0, 50.0)
MOST = 5.0  # Nm that is looked for
SOURCE = "Gaz et al., RA-L 2019"


def _regressors(context: Context) -> list[EffectRegressor]:
    offset = (Parameter("offset", "Nm", -MOST, MOST, 0.5),)
    hidden = {Stage.DYNAMICS: lambda c, j: -np.ones((len(c.samples), 1))}
    found = [EffectRegressor("torque_offset", offset, hidden, SOURCE, "unseen by the sensor")]
    if context.drive is not None:
        measured = {Stage.DRIVE: lambda c, j: np.ones((len(c.drive.time), 1))}
        found.append(EffectRegressor("torque_offset", offset, measured, SOURCE))
    return found


def _add_offset(values: HookContext) -> DriveFunction:
    offset = values("offset")
    return lambda torque: torque + offset


EFFECT = Effect(
    "torque_offset",
    EffectTarget.JOINT,
    (OFFSET,),
    _regressors,
    DetectionLimit("Nm", (0.06, 0.06, 0.05, 0.05, 0.02, 0.02, 0.015), (1, 2, 3, 4, 5, 6, 7)),
    drive=DriveHook(DriveSlot.OFFSET, _add_offset),
    sentence_template="the drive of {at} gives {offset:Nm more/less} than commanded",
)
