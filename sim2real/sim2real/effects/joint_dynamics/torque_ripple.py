"""Torque ripple: a torque that comes back with every turn of the wave generator."""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace
from sim2real.effects.behaviour import Resistance, Values
from sim2real.effects.evidence import Context
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import Parameter, Signature, stack
from sim2real.effects.stage import Stage

SINE, COSINE = Quantity("sine", "Nm", -3.0, 3.0), Quantity("cosine", "Nm", -3.0, 3.0)
ORDER = Quantity("order", "1/rad", 0.0, 1000.0)


def _signature(joint: int, order: int) -> Signature:
    return Signature(
        "torque_ripple",
        tuple(Parameter(q.name, "Nm", q.lower, q.upper, 0.1) for q in (SINE, COSINE)),
        {
            Stage.DYNAMICS: lambda c, j: stack(
                c.samples.filtered(j, lambda q, v: np.sin(order * q)),
                c.samples.filtered(j, lambda q, v: np.cos(order * q)),
            )
        },
        "order of the wave generator",
        f"order {order}",
        only_joint=joint,
        constants={"order": float(order)},
    )


def _signatures(context: Context) -> list[Signature]:
    return [_signature(joint, order) for joint, orders in context.ripples.items() for order in orders]


def _ripple(values: Values) -> Resistance:
    sine, cosine, order = values("sine"), values("cosine"), values("order")
    xp = namespace(sine)
    return lambda q, dq: sine * xp.sin(order * q) + cosine * xp.cos(order * q)


RECORD = EffectRecord(
    "torque_ripple",
    Place.JOINT,
    (SINE, COSINE, ORDER),
    _signatures,
    Visible("Nm", (0.06, 0.06, 0.05, 0.05, 0.02, 0.02, 0.015), (1, 2, 3, 4, 5, 6, 7)),
    joints=_ripple,
    said="the torque of {at} ripples as its gear turns, by {sine:Nm} (sine) and {cosine:Nm} (cosine)",
)
