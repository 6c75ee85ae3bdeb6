"""Armature: inertia of the rotor, reflected to the joint."""

from __future__ import annotations

import numpy as np

from sim2real.effects.background import INERTIA_ERROR, SURE
from sim2real.effects.evidence import Context
from sim2real.effects.panda_changes import added
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import Parameter, Signature, stack
from sim2real.effects.stage import Stage

INERTIA = Quantity("inertia", "kg m^2", -5.0, 5.0)
MOST = 1.0  # kg m^2 that is looked for


def _signature(context: Context, joint: int) -> Signature:
    """A rotor is told from the links that the joint turns where it is larger than their errors together."""
    links = context.rigid.own_sizes()[context.rigid.carried(joint)]
    least = SURE * INERTIA_ERROR * float(np.linalg.norm(links))
    return Signature(
        "armature",
        (Parameter("inertia", "kg m^2", -float(context.arm.armature.max()), MOST, 0.15, least=least),),
        {Stage.DYNAMICS: lambda c, j: stack(c.samples.acceleration[:, j])},
        "inertia of the rotor, reflected",
        only_joint=joint,
    )


def _signatures(context: Context) -> list[Signature]:
    return [_signature(context, joint) for joint in range(len(context.arm))]


RECORD = EffectRecord(
    "armature",
    Place.JOINT,
    (INERTIA,),
    _signatures,
    Visible("kg m^2", (0.03, 0.03, 0.03, 0.03, 0.01, 0.01, 0.008), (1, 2, 3, 4, 5, 6, 7)),
    panda=lambda panda, component, v: added(panda, "armature", component, v["inertia"]),
    said="{at} has {inertia:kg_m² more/less} rotor inertia",
)
