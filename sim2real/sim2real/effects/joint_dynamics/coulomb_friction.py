"""Coulomb friction: a level that resists sliding, whatever the speed."""

from __future__ import annotations

from sim2real.effects.evidence import Context
from sim2real.effects.panda_changes import added
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import Parameter, Signature, stack
from sim2real.effects.stage import Stage

LEVEL = Quantity("level", "Nm", -20.0, 20.0)
MOST = 4.0  # Nm that is looked for


def _signatures(context: Context) -> list[Signature]:
    return [
        Signature(
            "coulomb_friction",
            # No joint has less than none of what resists its motion.
            (Parameter("level", "Nm", -float(context.arm.frictionloss.max()), MOST, 0.3),),
            {Stage.DYNAMICS: lambda c, j: stack(c.prediction.direction[:, j])},
            "Gaz et al., RA-L 2019",
        )
    ]


RECORD = EffectRecord(
    "coulomb_friction",
    Place.JOINT,
    (LEVEL,),
    _signatures,
    Visible("Nm", (0.06, 0.06, 0.05, 0.05, 0.02, 0.02, 0.015), (1, 2, 3, 4, 5, 6, 7)),
    panda=lambda panda, component, v: added(panda, "frictionloss", component, v["level"]),
    said="{at} has {level:Nm more/less} dry friction",
)
