"""Torque ripple: a torque that comes back with every turn of the wave generator."""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import HookContext, ResistanceFunction
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

SINE, COSINE = Quantity("sine", "Nm", -3.0, 3.0), Quantity("cosine", "Nm", -3.0, 3.0)
ORDER = Quantity("order", "1/rad", 0.0, 1000.0)


def _regressor(joint: int, order: int) -> EffectRegressor:
    return EffectRegressor(
        "torque_ripple",
        tuple(Parameter(q.name, "Nm", q.lower, q.upper, 0.1) for q in (SINE, COSINE)),
        {
            Stage.DYNAMICS: lambda c, j: stack(
                c.samples.filter_function(j, lambda q, v: np.sin(order * q)),
                c.samples.filter_function(j, lambda q, v: np.cos(order * q)),
            )
        },
        "order of the wave generator",
        f"order {order}",
        only_joint=joint,
        constants={"order": float(order)},
    )


def _regressors(context: Context) -> list[EffectRegressor]:
    return [_regressor(joint, order) for joint, orders in context.ripples.items() for order in orders]


def _ripple_torque(values: HookContext) -> ResistanceFunction:
    sine, cosine, order = values("sine"), values("cosine"), values("order")
    xp = namespace(sine)
    return lambda q, dq: sine * xp.sin(order * q) + cosine * xp.cos(order * q)


EFFECT = Effect(
    "torque_ripple",
    EffectTarget.JOINT,
    (SINE, COSINE, ORDER),
    _regressors,
    DetectionLimit("Nm", (0.06, 0.06, 0.05, 0.05, 0.02, 0.02, 0.015), (1, 2, 3, 4, 5, 6, 7)),
    joints=_ripple_torque,
    sentence_template="the torque of {at} ripples as its gear turns, by {sine:Nm} (sine) and {cosine:Nm} (cosine)",
)
