"""A low-pass filter on the commanded torque (libfranka: 100 Hz). The controller's own: no simulated arm carries it."""

from __future__ import annotations

import numpy as np

from sim2real.effects.evidence import Context
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import SHARE, Shape, Signature, stack
from sim2real.effects.stage import Stage
from sim2real.effects.sums import first_order

TIME_CONSTANT = Quantity("time_constant", "s", 0.0, 0.2)
FILTERS = tuple(4e-4 * 1.35**n for n in range(14))  # s: so fine that the best one leaves nothing to other effects


def _signature(lag: float) -> Signature:
    def columns(c: Context, j: int) -> np.ndarray:
        return stack(first_order(c.drive, c.drive.law[:, j], lag) - c.drive.law[:, j])

    return Signature(
        "controller_mismatch",
        (SHARE,),
        {Stage.CONTROLLER: columns},
        "low-pass filter on the commanded torque (libfranka: 100 Hz)",
        f"{1e3 * lag:.3g} ms",
        Shape("time_constant", "s", lag, _signature, linear=True, least=1e-4),
        is_arm=True,
    )


def _signatures(context: Context) -> list[Signature]:
    return [] if context.drive is None else [_signature(lag) for lag in FILTERS]


RECORD = EffectRecord(
    "controller_mismatch",
    Place.ARM,
    (TIME_CONSTANT,),
    _signatures,
    Visible("s", 5e-4),
    said="the controller filters its torque, which {nominal} does not, with a time constant of {time_constant:ms}",
)
