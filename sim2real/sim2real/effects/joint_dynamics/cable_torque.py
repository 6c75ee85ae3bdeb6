"""A cable or hose that pulls: a spring, and its torque in the rest posture."""

from __future__ import annotations

import numpy as np

from np_description.panda import NOMINAL
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import HookContext, ResistanceFunction
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

STIFFNESS, OFFSET = Quantity("stiffness", "Nm/rad", 0.0, 3.0), Quantity("offset", "Nm", -1.0, 1.0)


def _regressors(context: Context) -> list[EffectRegressor]:
    return [
        EffectRegressor(
            "cable_torque",
            (
                Parameter("stiffness", "Nm/rad", STIFFNESS.lower, STIFFNESS.upper, 0.3),
                Parameter("offset", "Nm", OFFSET.lower, OFFSET.upper, 0.1),
            ),
            {Stage.DYNAMICS: lambda c, j: stack(c.samples.position[:, j] - c.arm.rest[j], np.ones(len(c.samples)))},
            "a spring, and its torque in the rest posture",
        )
    ]


def _cable_torque(values: HookContext) -> ResistanceFunction:
    stiffness, offset, slack = values("stiffness"), values("offset"), values.arrays.array(NOMINAL.ready)
    return lambda q, dq: stiffness * (q - slack) + offset


EFFECT = Effect(
    "cable_torque",
    EffectTarget.JOINT,
    (STIFFNESS, OFFSET),
    _regressors,
    DetectionLimit("Nm/rad", (0.08, 0.06, 0.06, 0.06, 0.03, 0.03, 0.02), (1, 2, 3, 4, 5, 6, 7)),
    joints=_cable_torque,
    sentence_template="a cable or hose pulls at {at}: {stiffness:Nm/rad} as a spring and {offset:Nm} in the rest posture",
)
