"""Torque saturation: the largest torque that the drive gives, the gravity that it compensates included."""

from __future__ import annotations

from functools import partial

import numpy as np

from np_common.rotations import namespace
from sim2real.effects import behaviour
from sim2real.effects.behaviour import DriveSlot, OnDrive, Values, unlimited
from sim2real.effects.evidence import Context, Drive
from sim2real.effects.limits import GRAVITY_APART, Limit, levels, lost
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import WHOLE, Shape, Signature, stack
from sim2real.effects.stage import Stage

LIMIT = Quantity("limit", "Nm", 0.0, 200.0)


def saturated(d: Drive, values: np.ndarray, limit: float, given: np.ndarray | None = None) -> np.ndarray:
    """values (n,) Nm within a limit Nm. It has no memory: what was given says nothing more."""
    return np.clip(values, -limit, limit)


def _signature(limit: float, joint: int, apart: bool) -> Signature:
    return Signature(
        "torque_saturation",
        (WHOLE,),
        {Stage.DRIVE: lambda c, j: stack(lost(c.drive, j, saturated, limit, apart))},
        "largest torque of the drive",
        f"{limit:.3g} Nm{', gravity apart' if apart else ''}",
        Shape("limit", "Nm", limit, partial(_signature, joint=joint, apart=apart)),
        only_joint=joint,
        constants={GRAVITY_APART.name: 1.0} if apart else {},
    )


def _levels(context: Context, joint: int, apart: bool, rows: np.ndarray) -> list[float]:
    """Limits Nm to try for rows (n,) bool of the drive."""
    d = context.drive
    held = 0.0 if apart else d.gravity[:, joint]
    return levels(d.commanded[:, joint] + held, (d.measured[:, joint] + held)[rows])


def _clip(values: Values) -> behaviour.Drive:
    limit = unlimited(values("limit"))
    return lambda torque: namespace(torque).clip(torque, -limit, limit)


_SHOWN = Limit(saturated, _levels, _signature)

RECORD = EffectRecord(
    "torque_saturation",
    Place.JOINT,
    (LIMIT, GRAVITY_APART),
    _SHOWN.signatures,
    Visible("share of the suite's peak", (0.07,) * 7, (1, 2, 3, 4, 5, 6, 7), largest=6),
    drive=OnDrive(DriveSlot.LIMIT, _clip, of_total=True),
    always=_SHOWN.always,
    said="the drive of {at} gives no more than {limit:Nm}",
)
