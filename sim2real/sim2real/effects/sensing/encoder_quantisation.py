"""An encoder that reads in steps too coarse to be left out. Seen in the readings themselves, not in torque."""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.hooks import HookContext, SensorHook, SensorSlot
from sim2real.effects.regressor import EffectRegressor, Parameter

STEP = Quantity("step", "rad", 0.0, 0.01)
SAME = 0.005  # relative difference of steps that are the same


def quantisation_regressor(step: float) -> EffectRegressor:
    """The finding that an encoder reads in steps (rad)."""
    return EffectRegressor(
        "encoder_quantisation",
        (Parameter("step", "rad", STEP.lower, STEP.upper, 1e-3),),
        {},
        "readings lie on a grid",
    )


def find_quanta(position: np.ndarray) -> np.ndarray:
    """Step rad (k,) of each encoder from its readings (n, k): 0 where they lie on no grid, or on a file's.

    A file rounds several joints to the same decimal of a radian or a degree; an encoder divides a turn by its lines.
    """
    quanta = np.array([find_quantum(column) for column in position.T])
    steps = quanta[quanta > 0]
    if len(steps) < 2 or np.ptp(steps) > SAME * steps.min():
        return quanta
    decimals = np.log10(np.mean(steps) / np.array([1.0, np.radians(1.0)]))
    is_rounded = (np.abs(decimals - np.round(decimals)) < SAME).any()
    return np.zeros(len(quanta)) if is_rounded else quanta


def find_quantum(position: np.ndarray) -> float:
    """Step rad of an encoder from its readings (n,): 0 where they lie on no grid."""
    steps = np.abs(np.diff(position))
    steps = steps[steps > 1e-12]
    if len(steps) < 100:
        return 0.0
    quantum = float(np.percentile(steps, 1))
    if quantum < 1e-7:
        return 0.0
    smallest = steps[steps < 1.5 * quantum]
    quantum = float(smallest.mean())
    off = np.abs(steps / quantum - np.round(steps / quantum))
    small = steps < 20 * quantum
    return quantum if small.sum() > 100 and np.mean(off[small] < 0.05) > 0.95 else 0.0


def _quantise(values: HookContext):
    step = values("step")
    xp, coarse = namespace(step), step > 0
    width = xp.where(coarse, step, 1.0)

    def sense(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return xp.where(coarse, xp.round(q / width) * step, q), dq, torque

    return sense


EFFECT = Effect(
    "encoder_quantisation",
    EffectTarget.JOINT,
    (STEP,),
    detection_limit=DetectionLimit("rad", (4e-5,) * 7, (1, 2, 3, 4, 5, 6, 7)),
    sensors=SensorHook(SensorSlot.STEP, _quantise),
    shows_in_motion=False,
    sentence_template="the encoder of {at} reads in steps of {step:mrad}",
)
