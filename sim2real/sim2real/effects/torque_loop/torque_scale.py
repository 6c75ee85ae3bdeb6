"""Gain of the torque loop: the drive gives more or less than it was asked for."""

from __future__ import annotations

from sim2real.effects.background import WEIGHT_KNOWN
from sim2real.effects.behaviour import Drive, DriveSlot, OnDrive, Values
from sim2real.effects.evidence import Context
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import Parameter, Signature, stack
from sim2real.effects.stage import Stage

SCALE = Quantity("scale", "1", -1.0, 2.0)
MOST = 0.5  # that is looked for
KNOWN = 0.005  # to which the torque constant of any drive is known
SOURCE = "gain of the torque loop"


def _signatures(context: Context) -> list[Signature]:
    if context.constant is not None:
        return []  # nobody can tell a wrong scale from an unknown one
    scale = (Parameter("scale", "1", -MOST, MOST, 0.03, least=KNOWN),)
    unseen = {Stage.DYNAMICS: lambda c, j: stack(-c.prediction.load[:, j])}
    found = [Signature("torque_scale", scale, unseen, SOURCE, "unseen by the sensor", model=WEIGHT_KNOWN)]
    if context.drive is not None:
        whole = {Stage.DRIVE: lambda c, j: stack(c.drive.commanded[:, j] + c.drive.gravity[:, j])}
        apart = {Stage.DRIVE: lambda c, j: stack(c.drive.commanded[:, j])}
        found.append(Signature("torque_scale", scale, whole, SOURCE, model=WEIGHT_KNOWN))
        found.append(Signature("torque_scale", scale, apart, SOURCE, "gravity apart"))
    return found


def _gain(values: Values) -> Drive:
    gain = 1 + values("scale")
    return lambda torque: gain * torque


RECORD = EffectRecord(
    "torque_scale",
    Place.JOINT,
    (SCALE,),
    _signatures,
    Visible("1", (0.02, 0.01, 0.01, 0.01, 0.02, 0.02, 0.03), (1, 2, 3, 4, 5, 6, 7), largest=8),
    drive=OnDrive(DriveSlot.GAIN, _gain),
    said="the drive of {at} gives {scale:% more/less} torque than it is asked for",
)
