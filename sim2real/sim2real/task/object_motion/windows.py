"""Windows of the object's motion, each from rest to rest: the hand comes down, does something to it, and is up again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from np_control.kinematics import forward_kinematics
from sim2real.task.suite.recording import TaskRecording
from sim2real.thresholds import THRESHOLDS

MOTION = THRESHOLDS.object_motion
FAMILIES = ("drag", "push", "shove", "tap")
"""Experiments that move the object."""


@dataclass(frozen=True, eq=False)
class MotionWindow:
    """The object's motion from rest to rest."""

    recording: TaskRecording
    """Recording."""
    experiment: str
    """Experiment."""
    rest_from: float
    """Time s of the log from which the object rests, until `begin`."""
    begin: float
    """Time s at which the tip comes down."""
    end: float
    """Time s at which the object rests again."""

    @property
    def rows(self) -> slice:
        """Rows of the log."""
        return slice(*np.searchsorted(self.recording.log.time, [self.begin, self.end]).tolist())

    @property
    def images(self) -> np.ndarray:
        """Numbers of the images that are predicted."""
        taken = self.recording.track.time + self.recording.seen_from
        return np.flatnonzero((taken > self.begin) & (taken < self.end))


def find_windows(recording: TaskRecording) -> Iterator[MotionWindow]:
    """All of a recording. A hand that comes down twice in an experiment makes two: what one stroke was predicted wrongly does not count
    against the next."""
    for name in (name for family in FAMILIES for name in recording.named(family)):
        for begin, end in find_strokes(recording, name):
            if end - begin > MOTION.least:
                yield MotionWindow(recording, name, begin - MOTION.rested, begin, end)


def find_strokes(recording: TaskRecording, name: str) -> Iterator[tuple[float, float]]:
    """(begin, end) s of an experiment between which the tip may touch the object, and what it does to it is seen."""
    time = recording.log.time[recording.rows(name)]
    height = forward_kinematics(recording.log.position[recording.rows(name)])[0][:, 2]
    down = np.flatnonzero(height < height.min() + MOTION.down)
    for stroke in np.split(down, np.flatnonzero(np.diff(down) > 1) + 1):
        yield float(time[stroke[0]]), min(float(time[stroke[-1]]) + MOTION.after, float(time[-1]))
