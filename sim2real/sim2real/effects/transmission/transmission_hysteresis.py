"""Hysteresis of the gear: its twist depends on where the load came from. No simulated arm has the motor's side."""

from __future__ import annotations

from functools import partial

import numpy as np

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.recurrences import bristle_state
from sim2real.effects.regressor import EffectRegressor, NonlinearParameter, Parameter, stack
from sim2real.effects.stage import Stage

WIDTH, STROKE = Quantity("width", "rad", 0.0, 0.05), Quantity("stroke", "rad", 0.0, 0.05)
STROKES = (1e-4, 2e-4, 4e-4, 1e-3)  # rad of twist over which the loop saturates
# rad/s of twist to and fro, too fast to be seen, by which noise of the commands shakes a gear. It lets go of what is wound
# up: taken for still, a gear that is shaken looks half as wide.
SHAKING = (0.0, 8e-5)
# It is known to a factor only. Shaken much faster than its load winds it, a gear shows the ratios of width, stroke and this
# speed, and hardly their size. Commands of 15 to 30 mNm of noise would give 80 to 180 urad/s, did no rotor resist.
RIVALS = (1.6e-4, 8e-5, 4e-5, 2e-5, 1e-5, 0.0)
# How well width and stroke are known at best for one such speed: that it is constant is an assumption too.
# Learnt on four arms of an opened set.
MODEL = 0.3


def _regressor(stroke: float, shaking: float) -> EffectRegressor:
    def columns(c: Context, j: int) -> np.ndarray:
        # K (twist + width z) = tau: z winds up with the twist, and takes up part of the torque.
        wound = [
            bristle_state(np.diff(w[:, j], prepend=w[:1, j]), stroke, shaking * (grid[1] - grid[0]))
            for w, (_, grid) in zip(c.transmission.wound, c.samples.grids)
        ]
        return -stack(c.samples.filter(wound))

    return EffectRegressor(
        "transmission_hysteresis",
        (Parameter("width", "rad", WIDTH.lower, WIDTH.upper, 3e-4),),
        {Stage.TRANSMISSION: columns},
        "Bouc-Wen on the twist (Wen, J. Eng. Mech. 1976; n = 1): dz = du - |du| z / stroke",
        f"{1e3 * stroke:.3g} mrad{', shaken' if shaking else ''}",
        NonlinearParameter(
            "stroke",
            "rad",
            stroke,
            partial(_regressor, shaking=shaking),
            rivals=tuple(partial(_regressor, shaking=other) for other in RIVALS if other != shaking),
        ),
        model=MODEL,
    )


def _regressors(context: Context) -> list[EffectRegressor]:
    if context.transmission is None:
        return []
    return [_regressor(stroke, shaking) for shaking in SHAKING for stroke in STROKES]


EFFECT = Effect(
    "transmission_hysteresis",
    EffectTarget.JOINT,
    (WIDTH, STROKE),
    _regressors,
    DetectionLimit("rad", (3e-5,) * 7, (1, 2, 3, 4, 5, 6, 7)),
    sentence_template="the gear of {at} stays twisted by up to {width:mrad} after its load has turned",
)
