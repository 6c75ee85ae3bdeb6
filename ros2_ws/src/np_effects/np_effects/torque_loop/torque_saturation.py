"""Torque saturation: the largest torque that the drive gives."""

from __future__ import annotations

import numpy as np

from np_effects.behaviour import Drive, DriveSlot, OnDrive, Values, unlimited
from np_effects.evidence import Context
from np_effects.record import EffectRecord, Place, Quantity, Visible
from np_effects.signature import WHOLE, Shape, Signature, stack
from np_effects.stage import Stage

LIMIT = Quantity("limit", "Nm", 0.0, 200.0)
LEVELS = tuple(0.95 * 0.88**n for n in range(8))  # of the largest torque commanded
REACHED = (0.97, 1.0)  # of the largest torque measured: a drive at its limit is there again and again


def _signature(limit: float, joint: int) -> Signature:
    return Signature(
        "torque_saturation",
        (WHOLE,),
        {Stage.DRIVE: lambda c, j: stack(np.clip(c.drive.commanded[:, j], -limit, limit) - c.drive.commanded[:, j])},
        "largest torque of the drive",
        f"{limit:.3g} Nm",
        Shape("limit", "Nm", limit, lambda value: _signature(value, joint)),
        only_joint=joint,
    )


def _signatures(context: Context) -> list[Signature]:
    if context.drive is None:
        return []
    found = []
    for j in range(len(context.arm)):
        largest = np.abs(context.drive.commanded[:, j]).max()
        reached = float(np.percentile(np.abs(context.drive.measured[:, j]), 99.8))
        found += [_signature(level * largest, j) for level in LEVELS]
        found += [_signature(level * reached, j) for level in REACHED]
    return found


def _clip(values: Values) -> Drive:
    limit = unlimited(values("limit"))
    return lambda torque: np.clip(torque, -limit, limit)


RECORD = EffectRecord(
    "torque_saturation",
    Place.JOINT,
    (LIMIT,),
    _signatures,
    Visible("share of the suite's peak", (0.07,) * 7, (1, 2, 3, 4, 5, 6, 7), largest=6),
    drive=OnDrive(DriveSlot.LIMIT, _clip),
)
