"""A base that stands crooked: gravity comes from another side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim2real.effects.background import WEIGHT_KNOWN
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.gravity import GravityModel
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

ROLL, PITCH = Quantity("roll", "rad", -0.2, 0.2), Quantity("pitch", "rad", -0.2, 0.2)


def _regressors(context: Context) -> list[EffectRegressor]:
    """Gravity turned about the base's x and y axis, by small angles."""
    size = np.linalg.norm(context.arm.gravity)
    about_x = context.rigid.gravity_torque(np.array([0.0, -size, 0.0]))
    about_y = context.rigid.gravity_torque(np.array([size, 0.0, 0.0]))
    return [
        EffectRegressor(
            "base_tilt",
            tuple(Parameter(q.name, "rad", q.lower, q.upper, 0.01) for q in (ROLL, PITCH)),
            {Stage.DYNAMICS: lambda c, j: stack(about_x[:, j], about_y[:, j])},
            "gravity in the frame of a base that stands crooked",
            is_arm=True,
            model=WEIGHT_KNOWN,
        )
    ]


def _add_tilt(weight: GravityModel, component: str, values: Mapping[str, float]) -> GravityModel:
    roll, pitch = weight.tilt
    return replace(weight, tilt=(roll + values["roll"], pitch + values["pitch"]))


EFFECT = Effect(
    "base_tilt",
    EffectTarget.ARM,
    (ROLL, PITCH),
    _regressors,
    DetectionLimit("rad", 0.0015),
    gravity_error=_add_tilt,
    sentence_template="the base stands crooked: {roll:deg} about x and {pitch:deg} about y",
)
