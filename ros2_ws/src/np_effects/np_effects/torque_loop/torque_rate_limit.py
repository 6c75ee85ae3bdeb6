"""Torque rate limit: how fast the drive follows a command at most."""

from __future__ import annotations

import numpy as np

from np_effects import evidence
from np_effects.behaviour import Drive, DriveSlot, OnDrive, Values, unlimited
from np_effects.evidence import Context
from np_effects.record import EffectRecord, Place, Quantity, Visible
from np_effects.signature import WHOLE, Shape, Signature, stack
from np_effects.stage import Stage

LIMIT = Quantity("limit", "Nm/s", 0.0, 1e5)
LEVELS = tuple(0.95 * 0.88**n for n in range(8))  # of the largest rate commanded
RAMP_KNOWN = 0.02  # of a rate: within a period a drive may ramp, or step at its end


def rate_limited(d: evidence.Drive, values: np.ndarray, rate: float) -> np.ndarray:
    """values (n,) followed at no more than `rate` a second, anew in each stretch."""
    step, limited = rate * d.period, values.copy()
    jumps = np.abs(np.diff(values, prepend=values[:1])) > step
    jumps[d.starts] = False
    ends = np.append(d.starts[1:], len(values))
    follows = 0  # row up to which the values have been followed
    for first in np.flatnonzero(jumps).tolist():
        if first < follows:
            continue
        end = int(ends[np.searchsorted(ends, first, side="right")])
        last = limited[first - 1]
        for i in range(first, end):
            value = values[i]
            last = min(max(value, last - step), last + step)
            limited[i] = last
            follows = i + 1
            if last == value:
                break
    return limited


def _signature(limit: float, joint: int) -> Signature:
    return Signature(
        "torque_rate_limit",
        (WHOLE,),
        {
            Stage.DRIVE: lambda c, j: stack(
                rate_limited(c.drive, c.drive.commanded[:, j], limit) - c.drive.commanded[:, j]
            )
        },
        "largest rate of the drive",
        f"{limit:.3g} Nm/s",
        Shape("limit", "Nm/s", limit, lambda value: _signature(value, joint), background=RAMP_KNOWN * limit),
        only_joint=joint,
    )


def _signatures(context: Context) -> list[Signature]:
    if context.drive is None:
        return []
    found = []
    for j in range(len(context.arm)):
        fastest = np.abs(np.diff(context.drive.commanded[:, j])).max() / context.drive.period
        found += [_signature(level * fastest, j) for level in LEVELS]
    return found


def _follow(values: Values) -> Drive:
    step, last = unlimited(values("limit")) * values.period, None

    def drive(torque: np.ndarray) -> np.ndarray:
        nonlocal last
        last = torque if last is None else np.clip(torque, last - step, last + step)
        return last

    return drive


RECORD = EffectRecord(
    "torque_rate_limit",
    Place.JOINT,
    (LIMIT,),
    _signatures,
    Visible("share of the suite's peak", (0.06,) * 7, (1, 2, 3, 4, 5, 6, 7), largest=6),
    drive=OnDrive(DriveSlot.RATE, _follow),
)
