"""Payload: a point mass at the tool point that the simulator does not model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from np_description.panda import Inertial, PandaModel
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

MASS = Quantity("mass", "kg", 0.0, 5.0)  # a hand that is not there is another nominal arm

PLACE = 0.05  # of the mass, to which it is known while where on the hand it lies is not: some cm of half a metre


def _regressors(context: Context) -> list[EffectRegressor]:
    x, y, z = context.arm.tip
    point = np.array([1.0, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    last = context.rigid.regressor(len(context.arm) - 1)
    return [
        EffectRegressor(
            "payload",
            (Parameter("mass", "kg", MASS.lower, MASS.upper, 0.3),),
            {Stage.DYNAMICS: lambda c, j: stack(last[:, j] @ point)},
            "a point mass at the tool point",
            is_arm=True,
            model=PLACE,
        )
    ]


def _add_payload(panda: PandaModel, component: str, values: Mapping[str, float]) -> PandaModel:
    hand = _add_point_mass(panda.inertials["hand"], values["mass"], panda.frames["hand_tcp"].position)
    return replace(panda, inertials={**panda.inertials, "hand": hand})


def _add_point_mass(body: Inertial, mass: float, point: np.ndarray) -> Inertial:
    """A body with a point mass kg at a point (3,) m of its frame."""
    total = body.mass + mass
    com = (body.mass * body.com + mass * point) / total
    xx, yy, zz, xy, xz, yz = body.inertia
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    for m, centre in ((body.mass, body.com), (mass, point)):
        arm = centre - com
        inertia = inertia + m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Inertial(total, com, np.array([inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]))


EFFECT = Effect(
    "payload",
    EffectTarget.ARM,
    (MASS,),
    _regressors,
    DetectionLimit("kg", 0.04),
    modify_rigid_body=_add_payload,
    gravity_error=lambda weight, component, values: weight,
    sentence_template="the arm carries {mass:kg} that {nominal} does not have",
)
