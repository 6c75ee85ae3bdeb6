"""Centre of mass of a link: its mass lies elsewhere than the simulator has it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from np_description.panda import PandaModel
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.joint_arrays import link_name
from sim2real.effects.regressor import EffectRegressor, Parameter
from sim2real.effects.stage import Stage

MOMENTS = tuple(Quantity(f"moment_{axis}", "kg m", -5.0, 5.0) for axis in "xyz")
MOST = 0.15  # kg m that is looked for


def _regressors(context: Context) -> list[EffectRegressor]:
    moments = tuple(Parameter(q.name, q.unit, -MOST, MOST, 0.05) for q in MOMENTS)
    return [
        EffectRegressor(
            "link_com",
            moments,
            {Stage.DYNAMICS: lambda c, j, table=context.rigid.mass_centre_change(i): table[:, j]},
            "inverse dynamics are linear in m c; the inertia about the joint goes with it, to first order",
            f"link {i + 1}",
            is_arm=True,
            component=context.arm.joints[i],
        )
        for i in range(len(context.arm))
    ]


def _move_centre(panda: PandaModel, component: str, values: Mapping[str, float]) -> PandaModel:
    name = link_name(panda, component)
    body = panda.inertials[name]
    shift = np.array([values[q.name] for q in MOMENTS]) / body.mass
    return replace(panda, inertials={**panda.inertials, name: replace(body, com=body.com + shift)})


EFFECT = Effect(
    "link_com",
    EffectTarget.LINK,
    MOMENTS,
    _regressors,
    DetectionLimit("kg m", (0.01, 0.01, 0.01, 0.01, 0.006, 0.005, 0.004), (2, 3, 4, 5, 6, 7)),
    modify_rigid_body=_move_centre,
    gravity_error=lambda weight, component, values: weight,
    sentence_template="the mass of {at} lies elsewhere: mass times place is off by {moment_x:kg_m} in x, {moment_y:kg_m} in y, {moment_z:kg_m} in z",
)
