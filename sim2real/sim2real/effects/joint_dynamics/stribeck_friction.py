"""Stribeck friction: more of it near standstill."""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace
from sim2real.effects.behaviour import Resistance, Values, direction
from sim2real.effects.evidence import Context
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import Parameter, Shape, Signature, stack
from sim2real.effects.stage import Stage
from sim2real.effects.sums import sign

BREAKAWAY, SPEED = Quantity("breakaway", "Nm", 0.0, 2.0), Quantity("speed", "rad/s", 0.0, 1.0)
SPEEDS = tuple(0.03 * 1.4**n for n in range(7))  # rad/s: so fine that the best one leaves nothing to other effects


def _signature(speed: float) -> Signature:
    return Signature(
        "stribeck_friction",
        (Parameter("breakaway", "Nm", BREAKAWAY.lower, BREAKAWAY.upper, 0.2),),
        {
            Stage.DYNAMICS: lambda c, j: stack(
                c.samples.filtered(j, lambda q, v: sign(v) * np.exp(-((v / speed) ** 2))),
            )
        },
        "Armstrong-Helouvry et al., Automatica 1994",
        f"{speed:.3g} rad/s",
        Shape("speed", "rad/s", speed, _signature),
    )


def _signatures(context: Context) -> list[Signature]:
    return [_signature(speed) for speed in SPEEDS]


def _near_standstill(values: Values) -> Resistance:
    breakaway, speed = values("breakaway"), values("speed").clip(1e-3)
    return lambda q, dq: breakaway * direction(dq) * namespace(dq).exp(-((dq / speed) ** 2))


RECORD = EffectRecord(
    "stribeck_friction",
    Place.JOINT,
    (BREAKAWAY, SPEED),
    _signatures,
    Visible("Nm", (0.08, 0.08, 0.07, 0.07, 0.03, 0.03, 0.02), (1, 2, 3, 4, 5, 6, 7), largest=6),
    joints=_near_standstill,
    said="{at} has {breakaway:Nm} of further friction near standstill, below about {speed:rad/s}",
)
