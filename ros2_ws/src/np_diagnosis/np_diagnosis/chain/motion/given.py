"""What of a patch is given: an effect that makes the object's motion surely worse, in the recordings that named it, is withheld."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.panda import NOMINAL, PandaModel
from np_diagnosis.chain.motion.stage import errors, share
from np_diagnosis.chain.task.recording import TaskRecording
from np_effects.patch import Patch
from np_effects.saying import Value


@dataclass(frozen=True)
class Given:
    """patch: what is given; withheld: of each effect that is not, the share of the error of the motion that it removed: all below 0."""

    patch: Patch
    withheld: dict[str, Value]


def given(
    recordings: Sequence[TaskRecording], patch: Patch, camera: Camera = CAMERA, panda: PandaModel = NOMINAL
) -> Given:
    """Of a patch and the recordings of one object that it was found in; all of it without any.

    An effect is asked beside those that stay: with it, and without. The worst goes first, for two that are wrong may hide each other. Two
    engines differ by as much as an effect of usual size changes in a window, so only what is worse in 95 % of draws of windows goes.
    """
    withheld: dict[str, Value] = {}
    after = errors(recordings, patch, camera, panda) if recordings and patch.effects else None
    while after is not None and patch.effects:
        asked = []
        for one in patch.effects:
            rest = Patch(tuple(e for e in patch.effects if e is not one))
            without = errors(recordings, rest, camera, panda)
            known = np.isfinite(without) & np.isfinite(after)
            if known.any():
                asked.append((share(without[known], after[known]), one.effect, rest, without))
        worse = [one for one in asked if one[0].high < 0]
        if not worse:
            break
        removed, effect, patch, after = min(worse, key=lambda one: one[0].value)
        withheld[effect] = removed
    return Given(patch, withheld)
