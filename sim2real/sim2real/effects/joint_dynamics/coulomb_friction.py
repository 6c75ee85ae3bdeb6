"""Coulomb friction: a level that resists sliding, whatever the speed."""

from __future__ import annotations

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.joint_arrays import add_to_joints
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

LEVEL = Quantity("level", "Nm", -20.0, 20.0)
MOST = 4.0  # Nm that is looked for


def _regressors(context: Context) -> list[EffectRegressor]:
    return [
        EffectRegressor(
            "coulomb_friction",
            # No joint has less than none of what resists its motion.
            (Parameter("level", "Nm", -float(context.arm.frictionloss.max()), MOST, 0.3),),
            {Stage.DYNAMICS: lambda c, j: stack(c.prediction.direction[:, j])},
            "Gaz et al., RA-L 2019",
        )
    ]


EFFECT = Effect(
    "coulomb_friction",
    EffectTarget.JOINT,
    (LEVEL,),
    _regressors,
    DetectionLimit("Nm", (0.06, 0.06, 0.05, 0.05, 0.02, 0.02, 0.015), (1, 2, 3, 4, 5, 6, 7)),
    modify_rigid_body=lambda panda, component, v: add_to_joints(panda, "frictionloss", component, v["level"]),
    sentence_template="{at} has {level:Nm more/less} dry friction",
)
