"""What of a patch is given: an effect that makes the object's motion surely worse, in the recordings that named it, is withheld. One of a
module that stays unexplained, or too small to be named, is given only if it makes that motion surely better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.panda import NOMINAL, PandaModel
from sim2real.effects.patch import Patch
from sim2real.effects.sentences import ValueWithInterval
from sim2real.task.diagnosis import TaskDiagnosis, make_doubtful_patch, make_patch
from sim2real.task.object_motion.prediction import (
    estimate_removed_share,
    estimate_typical_removed_share,
    prediction_errors,
)
from sim2real.task.suite.recording import TaskRecording


@dataclass(frozen=True)
class CheckedPatch:
    """What is given of a patch, by the object's motion."""

    patch: Patch
    """Effects that remain."""
    withheld: dict[str, ValueWithInterval]
    """Share of the motion error that each withheld effect removes, below 0."""
    added: dict[str, ValueWithInterval] = field(default_factory=dict)
    """Share of the motion error that each effect that was not named by itself removes, above 0."""


def check_patch(
    recordings: Sequence[TaskRecording], diagnosis: TaskDiagnosis, camera: Camera = CAMERA, panda: PandaModel = NOMINAL
) -> CheckedPatch:
    """What a diagnosis gives of all that it found in recordings of one object."""
    kept = withhold_harmful_effects(recordings, make_patch(diagnosis), camera, panda)
    return add_helpful_effects(recordings, kept, make_doubtful_patch(diagnosis), camera, panda)


def add_helpful_effects(
    recordings: Sequence[TaskRecording],
    kept: CheckedPatch,
    doubtful: Patch,
    camera: Camera = CAMERA,
    panda: PandaModel = NOMINAL,
) -> CheckedPatch:
    """The patch that is kept with each doubtful effect that makes the motion surely better beside it; unchanged without recordings."""
    if not (recordings and doubtful.effects):
        return kept
    patch, added = kept.patch, {}
    before = prediction_errors(recordings, patch, camera, panda)
    for one in doubtful.effects:
        more = Patch((*patch.effects, one))
        after = prediction_errors(recordings, more, camera, panda)
        removed = _removed_if_better(before, after)
        if removed is not None:
            patch, before, added[one.effect] = more, after, removed
    return CheckedPatch(patch, kept.withheld, added)


def withhold_harmful_effects(
    recordings: Sequence[TaskRecording], patch: Patch, camera: Camera = CAMERA, panda: PandaModel = NOMINAL
) -> CheckedPatch:
    """Of a patch and the recordings of one object that it was found in; all of it without any.

    An effect is tested beside those that stay: with it, and without. The worst goes first, for two that are wrong may hide each other. Two
    engines differ by as much as an effect of usual size changes in a window, so only what is surely worse goes (`_removed_if_worse`).
    """
    withheld: dict[str, ValueWithInterval] = {}
    after = prediction_errors(recordings, patch, camera, panda) if recordings and patch.effects else None
    while after is not None and patch.effects:
        worse = []
        for one in patch.effects:
            rest = Patch(tuple(e for e in patch.effects if e is not one))
            without = prediction_errors(recordings, rest, camera, panda)
            removed = _removed_if_worse(without, after)
            if removed is not None:
                worse.append((removed, one.effect, rest, without))
        if not worse:
            break
        removed, effect, patch, after = min(worse, key=lambda one: one[0].value)
        withheld[effect] = removed
    return CheckedPatch(patch, withheld)


def _removed_if_better(before: np.ndarray, after: np.ndarray) -> ValueWithInterval | None:
    """The share of the error of windows (n,) px that is gone after, where that is surely more than none."""
    before, after = _predicted(before, after)
    removed = estimate_removed_share(before, after) if before.size else None
    return removed if removed is not None and removed.low > 0 else None


def _removed_if_worse(without: np.ndarray, after: np.ndarray) -> ValueWithInterval | None:
    """The share of the error of windows (n,) px that is gone after, where that is surely less than none, in 95 % of draws of them: of their sum; or of
    what is left of one, on geometric average, where the sum is no better. A few windows in which a tip slips or holds by chance are most of a
    sum, and hide that nearly all others are worse; what is better in sum stays, for one tap that comes right is worth many drags."""
    without, after = _predicted(without, after)
    if not without.size:
        return None
    removed = estimate_removed_share(without, after)
    is_worse = removed.high < 0 or (removed.value < 0 and estimate_typical_removed_share(without, after).high < 0)
    return removed if is_worse else None


def _predicted(before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of errors (n,) of the same windows those that both could predict."""
    known = np.isfinite(before) & np.isfinite(after)
    return before[known], after[known]
