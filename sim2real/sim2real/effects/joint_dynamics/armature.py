"""Armature: inertia of the rotor, reflected to the joint."""

from __future__ import annotations

import numpy as np

from sim2real.effects.background import INERTIA_ERROR, SURE
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.joint_arrays import add_to_joints
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

INERTIA = Quantity("inertia", "kg m^2", -5.0, 5.0)
MOST = 1.0  # kg m^2 that is looked for


def _regressor(context: Context, joint: int) -> EffectRegressor:
    """A rotor is distinguishable from the links that the joint turns where it is larger than their errors together."""
    links = context.rigid.link_inertia_traces()[context.rigid.links_moved_by(joint)]
    least = SURE * INERTIA_ERROR * float(np.linalg.norm(links))
    return EffectRegressor(
        "armature",
        (Parameter("inertia", "kg m^2", -float(context.arm.armature.max()), MOST, 0.15, least=least),),
        {Stage.DYNAMICS: lambda c, j: stack(c.samples.acceleration[:, j])},
        "inertia of the rotor, reflected",
        only_joint=joint,
    )


def _regressors(context: Context) -> list[EffectRegressor]:
    return [_regressor(context, joint) for joint in range(len(context.arm))]


EFFECT = Effect(
    "armature",
    EffectTarget.JOINT,
    (INERTIA,),
    _regressors,
    DetectionLimit("kg m^2", (0.03, 0.03, 0.03, 0.03, 0.01, 0.01, 0.008), (1, 2, 3, 4, 5, 6, 7)),
    modify_rigid_body=lambda panda, component, v: add_to_joints(panda, "armature", component, v["inertia"]),
    sentence_template="{at} has {inertia:kg_m² more/less} rotor inertia",
)
