"""Thermal drift: friction changes while the grease warms up."""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace
from np_description.panda import NOMINAL
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import HookContext, ResistanceFunction, smooth_direction
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

CHANGE, DURATION = Quantity("change", "1", -0.9, 0.9), Quantity("duration", "s", 0.0, 1e4)
WARM_UP = (40.0, 70.0, 110.0, 180.0)  # s
USUAL_DURATION = 180.0  # s over which friction changes by the whole of `change`, where a patch sets none


def _regressor(variant: str, course) -> EffectRegressor:
    """Friction that changes over the recording: a share of what the nominal joint has."""

    def columns(c: Context, j: int) -> np.ndarray:
        since = c.samples.time + c.begins[c.samples.trajectory]
        total = since.max() if len(since) else 1.0
        return stack(course(since, total) * c.prediction.friction[:, j])

    return EffectRegressor(
        "thermal_drift",
        (Parameter("change", "1", CHANGE.lower, CHANGE.upper, 0.2),),
        {Stage.DYNAMICS: columns},
        "friction falls as the grease warms up",
        variant,
    )


def _regressors(context: Context) -> list[EffectRegressor]:
    return [
        _regressor("linear in time", lambda u, total: u / total),
        *(_regressor(f"warming up in {s:g} s", lambda u, total, s=s: 1 - np.exp(-u / s)) for s in WARM_UP),
    ]


def _drifting_torque(values: HookContext) -> ResistanceFunction:
    change, lasting = values("change"), values("duration")
    xp, array = namespace(change), values.arrays.array
    duration, time = xp.where(lasting > 0, lasting, USUAL_DURATION), array(values.begin)
    coulomb, viscous = array(NOMINAL.frictionloss), array(NOMINAL.damping)

    def resist(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        nonlocal time
        time = time + values.period
        nominal = coulomb * smooth_direction(dq) + viscous * dq
        return change * (time[..., None] / duration).clip(None, 1.0) * nominal

    return resist


EFFECT = Effect(
    "thermal_drift",
    EffectTarget.JOINT,
    (CHANGE, DURATION),
    _regressors,
    DetectionLimit("1", (0.15, 0.25, 0.17, 0.1, 0.06, 0.08, 0.1), (1, 4, 5, 6, 7), largest=4),
    joints=_drifting_torque,
    sentence_template="the friction of {at} becomes {change:% more/less} as the recording goes on",
)
