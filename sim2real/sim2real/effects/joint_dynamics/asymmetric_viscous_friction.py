"""Viscous friction of another coefficient in each direction."""

from __future__ import annotations

import numpy as np

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import HookContext, ResistanceFunction
from sim2real.effects.joint_arrays import add_to_joints
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

POSITIVE = Quantity("coefficient_positive", "Nms/rad", -8.0, 8.0)
NEGATIVE = Quantity("coefficient_negative", "Nms/rad", -8.0, 8.0)


def _regressors(context: Context) -> list[EffectRegressor]:
    lower = -float(context.arm.damping.max())
    return [
        EffectRegressor(
            "asymmetric_viscous_friction",
            tuple(Parameter(q.name, "Nms/rad", lower, q.upper, 0.3) for q in (POSITIVE, NEGATIVE)),
            {
                Stage.DYNAMICS: lambda c, j: stack(
                    c.samples.filter_function(j, lambda q, v: np.maximum(v, 0)),
                    c.samples.filter_function(j, lambda q, v: np.minimum(v, 0)),
                )
            },
            "Gaz et al., RA-L 2019",
        )
    ]


def _asymmetric_torque(values: HookContext) -> ResistanceFunction:
    half = 0.5 * (values("coefficient_positive") - values("coefficient_negative"))
    return lambda q, dq: half * abs(dq)


EFFECT = Effect(
    "asymmetric_viscous_friction",
    EffectTarget.JOINT,
    (POSITIVE, NEGATIVE),
    _regressors,
    DetectionLimit("Nms/rad", (0.08, 0.08, 0.07, 0.07, 0.03, 0.03, 0.02), (1, 2, 3, 4, 5, 6, 7)),
    modify_rigid_body=lambda panda, component, v: add_to_joints(
        panda, "damping", component, 0.5 * (v["coefficient_positive"] + v["coefficient_negative"])
    ),
    joints=_asymmetric_torque,
    sentence_template="{at} has {coefficient_positive:Nms/rad more/less} friction by speed when it turns forwards and {coefficient_negative:Nms/rad more/less} backwards",
)
