"""What a patch is worth: the object's motion, predicted in MuJoCo with the nominal set-up and with the patch, beside what was seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.panda import NOMINAL, PandaModel
from sim2real.effects.patch import Patch
from sim2real.effects.sentences import ValueWithInterval
from sim2real.recordings.reading import ContractViolation
from sim2real.task.object_motion.simulator import WindowSimulator
from sim2real.task.object_motion.windows import MotionWindow, find_windows
from sim2real.task.suite.recording import TaskRecording
from sim2real.thresholds import THRESHOLDS

MOTION = THRESHOLDS.object_motion


@dataclass(frozen=True)
class MotionPrediction:
    """Error of the predicted motion of the object, without a patch and with it."""

    before: float
    """Mean error px of corners over windows, nominal."""
    after: float
    """The same with the patch."""
    windows: int
    """Windows that were predicted."""
    removed: ValueWithInterval
    """Share of the error that the patch removes; negative where it does harm."""
    by_effect: dict[str, float]
    """Share that is lost without each effect."""
    held_out: bool = False
    """Whether no stage has used these recordings."""


def prediction_errors(
    recordings: Sequence[TaskRecording],
    patch: Patch,
    camera: Camera = CAMERA,
    panda: PandaModel = NOMINAL,
) -> np.ndarray:
    """px (n,) of all windows of recordings of one object, NaN of those that cannot be predicted.

    Each is the mean over frictions of the table, rougher by these shares, by which two engines differ: where a tip hops, a hundredth more or
    less of it decides where the object goes, and one draw is no evidence on the patch.
    """
    windows = [window for one in recordings for window in find_windows(one)]
    simulators = (WindowSimulator(recordings[0].domain, patch, camera, panda, more) for more in MOTION.rougher)
    return np.mean([[_error(simulated, window) for window in windows] for simulated in simulators], axis=0)


def predict_motion(
    recordings: Sequence[TaskRecording],
    patch: Patch,
    camera: Camera = CAMERA,
    panda: PandaModel = NOMINAL,
    held_out: bool = False,
) -> MotionPrediction | None:
    """Of recordings of one object; None where nothing of them can be predicted. A patch without effects removes nothing, and shows how far off the
    nominal set-up is."""

    def off(some: Patch) -> np.ndarray:
        return prediction_errors(recordings, some, camera, panda)

    before = off(Patch())
    after = off(patch) if patch.effects else before
    known = np.isfinite(before) & np.isfinite(after)
    if not known.any():
        return None
    without = {}
    if len(patch.effects) > 1:
        for one in patch.effects:
            rest = off(Patch(tuple(e for e in patch.effects if e is not one)))
            both = known & np.isfinite(rest)
            without[one.effect] = float((rest - after)[both].sum() / before[both].sum())
    removed = estimate_removed_share(before[known], after[known])
    alone = {e.effect: removed.value for e in patch.effects}
    return MotionPrediction(
        float(before[known].mean()), float(after[known].mean()), int(known.sum()), removed, without or alone, held_out
    )


def estimate_removed_share(before: np.ndarray, after: np.ndarray) -> ValueWithInterval:
    """Share of errors (n,) that is gone after, with its 95 % interval by the bootstrap over windows."""
    draws = _draw(len(before))
    return _share_with_interval(after.sum() / before.sum(), after[draws].sum(axis=1) / before[draws].sum(axis=1))


def estimate_typical_removed_share(before: np.ndarray, after: np.ndarray) -> ValueWithInterval:
    """As `estimate_removed_share`, of the geometric mean of what is left of each window's error (n,): in it a window counts as much as any other, where a sum is
    the result of a few in which a tip hops."""
    left = np.log(after / before)
    return _share_with_interval(np.exp(left.mean()), np.exp(left[_draw(len(left))].mean(axis=1)))


def _draw(count: int) -> np.ndarray:
    return np.random.default_rng(0).integers(count, size=(MOTION.draws, count))


def _share_with_interval(left: float, draws: np.ndarray) -> ValueWithInterval:
    """1 - left, with the interval of draws of it."""
    low, high = np.quantile(1 - draws, [0.025, 0.975])
    return ValueWithInterval(float(1 - left), float(low), float(high))


def _error(simulated: WindowSimulator, window: MotionWindow) -> float:
    try:
        return simulated.error(window)
    except (ContractViolation, FloatingPointError):
        return np.nan
