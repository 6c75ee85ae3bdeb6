"""Viscous friction: proportional to speed."""

from __future__ import annotations

from sim2real.effects.evidence import Context
from sim2real.effects.panda_changes import added
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import Parameter, Signature, stack
from sim2real.effects.stage import Stage

COEFFICIENT = Quantity("coefficient", "Nms/rad", -50.0, 50.0)
MOST = 8.0  # Nms/rad that is looked for


def _signatures(context: Context) -> list[Signature]:
    return [
        Signature(
            "viscous_friction",
            (Parameter("coefficient", "Nms/rad", -float(context.arm.damping.max()), MOST, 0.3),),
            {Stage.DYNAMICS: lambda c, j: stack(c.samples.velocity[:, j])},
            "Gaz et al., RA-L 2019",
        )
    ]


RECORD = EffectRecord(
    "viscous_friction",
    Place.JOINT,
    (COEFFICIENT,),
    _signatures,
    Visible("Nms/rad", (0.08, 0.08, 0.07, 0.07, 0.03, 0.03, 0.02), (1, 2, 3, 4, 5, 6, 7)),
    panda=lambda panda, component, v: added(panda, "damping", component, v["coefficient"]),
    said="{at} has {coefficient:Nms/rad more/less} friction by speed",
)
