"""Offset of the torque loop: what a drive gives when nothing is asked for."""

from __future__ import annotations

import numpy as np

from sim2real.effects.behaviour import Drive, DriveSlot, OnDrive, Values
from sim2real.effects.evidence import Context
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import Parameter, Signature
from sim2real.effects.stage import Stage

OFFSET = Quantity("offset", "Nm", -50.0, 50.0)
MOST = 5.0  # Nm that is looked for
SOURCE = "Gaz et al., RA-L 2019"


def _signatures(context: Context) -> list[Signature]:
    offset = (Parameter("offset", "Nm", -MOST, MOST, 0.5),)
    unseen = {Stage.DYNAMICS: lambda c, j: -np.ones((len(c.samples), 1))}
    found = [Signature("torque_offset", offset, unseen, SOURCE, "unseen by the sensor")]
    if context.drive is not None:
        seen = {Stage.DRIVE: lambda c, j: np.ones((len(c.drive.time), 1))}
        found.append(Signature("torque_offset", offset, seen, SOURCE))
    return found


def _add(values: Values) -> Drive:
    offset = values("offset")
    return lambda torque: torque + offset


RECORD = EffectRecord(
    "torque_offset",
    Place.JOINT,
    (OFFSET,),
    _signatures,
    Visible("Nm", (0.06, 0.06, 0.05, 0.05, 0.02, 0.02, 0.015), (1, 2, 3, 4, 5, 6, 7)),
    drive=OnDrive(DriveSlot.OFFSET, _add),
    said="the drive of {at} gives {offset:Nm more/less} than it is asked for",
)
