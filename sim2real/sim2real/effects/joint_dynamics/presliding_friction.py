"""Presliding friction: it builds up over a distance instead of at once."""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import HookContext, ResistanceFunction
from sim2real.effects.recurrences import dahl_state
from sim2real.effects.regressor import EffectRegressor, NonlinearParameter, Parameter, stack
from sim2real.effects.stage import Stage

LEVEL, STROKE = Quantity("level", "Nm", 0.0, 4.0), Quantity("stroke", "rad", 0.0, 0.5)
STROKES = tuple(0.003 * 1.4**n for n in range(9))  # rad: so fine that the best one leaves nothing to other effects
# rad: the catalogue has 3 to 30 mrad; hoses and seals that slide after more follow the same law by another cause.
MOST = 0.045


def _regressor(stroke: float) -> EffectRegressor:
    """More friction, of a kind that builds up."""

    def columns(c: Context, j: int) -> np.ndarray:
        return stack(c.samples.filter_function(j, lambda q, v: dahl_state(q, stroke)))

    return EffectRegressor(
        "presliding_friction",
        (Parameter("level", "Nm", LEVEL.lower, LEVEL.upper, 0.4),),
        {Stage.DYNAMICS: columns},
        "Dahl 1968: dF/dx = (Fc - F sgn v) / x0",
        f"{1e3 * stroke:.3g} mrad",
        NonlinearParameter("stroke", "rad", stroke, _regressor, upper=MOST),
    )


def _regressors(context: Context) -> list[EffectRegressor]:
    return [_regressor(stroke) for stroke in STROKES]


def _dahl_torque(values: HookContext) -> ResistanceFunction:
    level, stroke = values("level"), values("stroke").clip(1e-4)
    bristle, last = 0.0 * level, None

    def resist(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        nonlocal bristle, last
        xp = namespace(q)
        moved = q - (q if last is None else last)
        last = xp.asarray(q, copy=True)
        bristle = xp.sign(moved) + (bristle - xp.sign(moved)) * xp.exp(-abs(moved) / stroke)
        return level * bristle

    return resist


EFFECT = Effect(
    "presliding_friction",
    EffectTarget.JOINT,
    (LEVEL, STROKE),
    _regressors,
    DetectionLimit("Nm", (0.09, 0.09, 0.08, 0.08, 0.03, 0.03, 0.02), (1, 2, 3, 4, 5, 6, 7)),
    joints=_dahl_torque,
    sentence_template="{at} has {level:Nm} of dry friction that builds up over {stroke:mrad} after each reversal",
)
