"""Coulomb friction of another level in each direction."""

from __future__ import annotations

from np_effects.behaviour import Resistance, Values, direction
from np_effects.evidence import Context
from np_effects.panda_changes import added
from np_effects.record import EffectRecord, Place, Quantity, Visible
from np_effects.signature import Parameter, Signature, stack
from np_effects.stage import Stage
from np_effects.sums import sign

POSITIVE, NEGATIVE = Quantity("level_positive", "Nm", -4.0, 4.0), Quantity("level_negative", "Nm", -4.0, 4.0)


def _signatures(context: Context) -> list[Signature]:
    lower = -float(context.arm.frictionloss.max())
    return [
        Signature(
            "asymmetric_coulomb_friction",
            tuple(Parameter(q.name, "Nm", lower, q.upper, 0.3) for q in (POSITIVE, NEGATIVE)),
            {
                # From the one level to the other through their mean: the forces of Coulomb friction with an offset, at a turn
                # as well, or turns would seem to tell the two apart.
                Stage.DYNAMICS: lambda c, j: stack(
                    c.samples.filtered(j, lambda q, v: (sign(v) + 1) / 2),
                    c.samples.filtered(j, lambda q, v: (sign(v) - 1) / 2),
                )
            },
            "Gaz et al., RA-L 2019",
        )
    ]


def _uneven(values: Values) -> Resistance:
    # Half the sum of both levels slows both ways (`panda`); half their difference is a torque of one sign.
    half = 0.5 * (values("level_positive") - values("level_negative"))
    return lambda q, dq: half * abs(direction(dq))


RECORD = EffectRecord(
    "asymmetric_coulomb_friction",
    Place.JOINT,
    (POSITIVE, NEGATIVE),
    _signatures,
    Visible("Nm", (0.06, 0.06, 0.05, 0.05, 0.02, 0.02, 0.015), (1, 2, 3, 4, 5, 6, 7)),
    panda=lambda panda, component, v: added(
        panda, "frictionloss", component, 0.5 * (v["level_positive"] + v["level_negative"])
    ),
    joints=_uneven,
    said="{at} has {level_positive:Nm more/less} dry friction when it turns forwards and {level_negative:Nm more/less} backwards",
)
