"""Viscous friction: proportional to speed."""

from __future__ import annotations

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.joint_arrays import add_to_joints
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

COEFFICIENT = Quantity("coefficient", "Nms/rad", -50.0, 50.0)
MOST = 8.0  # Nms/rad that is looked for


def _regressors(context: Context) -> list[EffectRegressor]:
    return [
        EffectRegressor(
            "viscous_friction",
            (Parameter("coefficient", "Nms/rad", -float(context.arm.damping.max()), MOST, 0.3),),
            {Stage.DYNAMICS: lambda c, j: stack(c.samples.velocity[:, j])},
            "Gaz et al., RA-L 2019",
        )
    ]


EFFECT = Effect(
    "viscous_friction",
    EffectTarget.JOINT,
    (COEFFICIENT,),
    _regressors,
    DetectionLimit("Nms/rad", (0.08, 0.08, 0.07, 0.07, 0.03, 0.03, 0.02), (1, 2, 3, 4, 5, 6, 7)),
    modify_rigid_body=lambda panda, component, v: add_to_joints(panda, "damping", component, v["coefficient"]),
    sentence_template="{at} has {coefficient:Nms/rad more/less} friction by speed",
)
