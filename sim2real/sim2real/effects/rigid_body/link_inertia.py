"""Inertia of a link about its own centre of mass."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from np_description.panda import PandaModel
from sim2real.effects.background import INERTIA_ERROR, SURE
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.joint_arrays import link_name
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

SCALE = Quantity("scale", "1", -1.0, 50.0)
LEAST, MOST = -0.9, 5.0  # that is looked for
AXES = 0.25  # of the change, to which one number describes it: an added body has axes of its own


def _regressors(context: Context) -> list[EffectRegressor]:
    # A joint feels the errors of all links that it turns: one link's can be distinguished from those of the others only where it is
    # larger than they are together.
    own = context.rigid.link_inertia_traces()
    known = SURE * INERTIA_ERROR * np.linalg.norm(own) / np.maximum(own, 1e-9)
    return [
        EffectRegressor(
            "link_inertia",
            (Parameter("scale", "1", LEAST, MOST, 0.5, least=min(known[i], 2.0)),),
            {Stage.DYNAMICS: lambda c, j, i=i: stack(c.prediction.inertia[:, j, i])},
            "inverse dynamics are linear in the inertia about the centre of mass",
            f"link {i + 1}",
            is_arm=True,
            component=context.arm.joints[i],
            model=AXES,
        )
        for i in range(len(context.arm))
    ]


def _scale_inertia(panda: PandaModel, component: str, values: Mapping[str, float]) -> PandaModel:
    name = link_name(panda, component)
    body = panda.inertials[name]
    heavier = replace(body, inertia=body.inertia * (1 + values["scale"]))
    return replace(panda, inertials={**panda.inertials, name: heavier})


EFFECT = Effect(
    "link_inertia",
    EffectTarget.LINK,
    (SCALE,),
    _regressors,
    DetectionLimit("1", (0.3, 0.3, 0.3, 0.3, 0.15, 0.4, 0.3), (3, 4, 5, 7)),
    modify_rigid_body=_scale_inertia,
    sentence_template="{at} has {scale:% more/less} inertia about its own centre of mass",
)
