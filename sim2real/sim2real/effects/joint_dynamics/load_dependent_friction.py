"""Friction proportional to the load through the gear."""

from __future__ import annotations

import numpy as np

from np_description.panda import NOMINAL
from sim2real.effects.background import WEIGHT_KNOWN
from sim2real.effects.behaviour import Resistance, Values, direction
from sim2real.effects.evidence import Context
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import Parameter, Signature, stack
from sim2real.effects.stage import Stage

COEFFICIENT = Quantity("coefficient", "1", 0.0, 0.5)


def _signatures(context: Context) -> list[Signature]:
    return [
        Signature(
            "load_dependent_friction",
            (Parameter("coefficient", "1", COEFFICIENT.lower, COEFFICIENT.upper, 0.05),),
            {Stage.DYNAMICS: lambda c, j: stack(np.abs(c.prediction.load[:, j]) * c.prediction.direction[:, j])},
            "friction proportional to the load through the gear",
            model=WEIGHT_KNOWN,
        )
    ]


def _by_load(values: Values) -> Resistance:
    coefficient, hold = values("coefficient"), values.arrays.hold(NOMINAL)
    return lambda q, dq: coefficient * abs(hold(q)) * direction(dq)


RECORD = EffectRecord(
    "load_dependent_friction",
    Place.JOINT,
    (COEFFICIENT,),
    _signatures,
    Visible("1", (0.02, 0.004, 0.008, 0.004, 0.02, 0.015, 0.03), (2, 3, 4, 6), largest=8),
    joints=_by_load,
    said="{at} has dry friction that is {coefficient:%} of its load",
)
