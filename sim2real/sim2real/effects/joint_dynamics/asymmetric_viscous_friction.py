"""Viscous friction of another coefficient in each direction."""

from __future__ import annotations

import numpy as np

from sim2real.effects.behaviour import Resistance, Values
from sim2real.effects.evidence import Context
from sim2real.effects.panda_changes import added
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import Parameter, Signature, stack
from sim2real.effects.stage import Stage

POSITIVE = Quantity("coefficient_positive", "Nms/rad", -8.0, 8.0)
NEGATIVE = Quantity("coefficient_negative", "Nms/rad", -8.0, 8.0)


def _signatures(context: Context) -> list[Signature]:
    lower = -float(context.arm.damping.max())
    return [
        Signature(
            "asymmetric_viscous_friction",
            tuple(Parameter(q.name, "Nms/rad", lower, q.upper, 0.3) for q in (POSITIVE, NEGATIVE)),
            {
                Stage.DYNAMICS: lambda c, j: stack(
                    c.samples.filtered(j, lambda q, v: np.maximum(v, 0)),
                    c.samples.filtered(j, lambda q, v: np.minimum(v, 0)),
                )
            },
            "Gaz et al., RA-L 2019",
        )
    ]


def _uneven(values: Values) -> Resistance:
    half = 0.5 * (values("coefficient_positive") - values("coefficient_negative"))
    return lambda q, dq: half * abs(dq)


RECORD = EffectRecord(
    "asymmetric_viscous_friction",
    Place.JOINT,
    (POSITIVE, NEGATIVE),
    _signatures,
    Visible("Nms/rad", (0.08, 0.08, 0.07, 0.07, 0.03, 0.03, 0.02), (1, 2, 3, 4, 5, 6, 7)),
    panda=lambda panda, component, v: added(
        panda, "damping", component, 0.5 * (v["coefficient_positive"] + v["coefficient_negative"])
    ),
    joints=_uneven,
    said="{at} has {coefficient_positive:Nms/rad more/less} friction by speed when it turns forwards and {coefficient_negative:Nms/rad more/less} backwards",
)
