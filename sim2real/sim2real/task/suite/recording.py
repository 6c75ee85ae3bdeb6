"""A recording of the task suite, cut into its experiments."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from np_control.dynamics import Dynamics
from np_description.domains import Task
from np_description.phases import EXCITE
from sim2real.excitation.contact_suite.suite import FAMILIES
from sim2real.recordings.reading import SECOND, ContractViolation, bag_violation
from sim2real.recordings.signals import Log
from sim2real.task.keypoint_track import KeypointTrack, read_keypoint_track


@dataclass(frozen=True, eq=False)
class TaskRecording:
    """A recording of the task suite."""

    log: Log
    """Joints."""
    track: KeypointTrack
    """Keypoints; their time 0 is at `seen_from` of the log."""
    seen_from: float
    """Time s of the first image in the log."""
    domain: Task
    """Nominal object, surroundings and contacts."""
    spans: dict[str, tuple[float, float]]
    """(begin, end) s of each experiment by name."""

    def named(self, family: str) -> list[str]:
        """Names of the experiments of a family that were made, in order."""
        return [name for name in self.spans if name == family or name.rsplit("_", 1)[0] == family]

    def pushes(self) -> list[str]:
        """Names of the pushes, then of the shoves, that were made."""
        return self.named("push") + self.named("shove")

    def rows(self, name: str) -> slice:
        """Rows of the log in an experiment."""
        begin, end = self.spans[name]
        return slice(*np.searchsorted(self.log.time, [begin, end]).tolist())

    def images(self, name: str) -> np.ndarray:
        """Numbers of the images that were taken in an experiment."""
        begin, end = self.spans[name]
        time = self.track.time + self.seen_from
        return np.flatnonzero((time >= begin) & (time < end))


def spans_of(log: Log) -> dict[str, tuple[float, float]]:
    """(begin, end) s of each experiment of the task suite in a log; transfers between them are left out."""
    starts = [(at, state.experiment if state.phase == EXCITE else "") for at, state in log.phases]
    ends = [*(at for at, _ in starts[1:]), float(log.time[-1])]
    intervals = zip(starts, ends)
    return {n: (begin, end) for (begin, n), end in intervals if n in FAMILIES or n.rsplit("_", 1)[0] in FAMILIES}


def correct_encoders(recording: TaskRecording, bias: np.ndarray) -> TaskRecording:
    """The recording with the angles (rad) that the joints had, where encoders read so much, bias (7,), too much.

    Torques without gravity lack that of the angles that were read: what this differs from gravity at the true ones is added. Commands stay.
    """
    if not np.any(bias):
        return recording
    log, gravity = recording.log, Dynamics().gravity
    position = log.position - bias
    torque = log.torque
    if not log.with_gravity:
        torque = torque + np.array([gravity(read) - gravity(true) for read, true in zip(log.position, position)])
    return replace(recording, log=replace(log, position=position, torque=torque))


class NotATaskSuite(ContractViolation):
    """A recording that is whole, and not of the task suite."""


def read_task(path: str | Path, log: Log) -> TaskRecording:
    """A rosbag2 recording of the task suite; log: its joints. Raises NotATaskSuite for another one, ContractViolation."""
    from np_record.bag import BagError, Recording  # slow
    from np_record.recorded_episode import read_recorded_task

    spans = spans_of(log)
    if not spans:
        raise NotATaskSuite(f"bag {path}: expected experiments of the task suite ({', '.join(FAMILIES)}), got none")
    track = read_keypoint_track(path)
    try:
        with Recording(path, required=("joint_states", "keypoints")) as recording:
            domain = read_recorded_task(recording)
            first, first_image = (recording.rows(topic)[topic][0].stamp for topic in ("joint_states", "keypoints"))
    except BagError as error:
        raise bag_violation(path, error) from error
    return TaskRecording(log, track, (first_image - first) / SECOND, domain, spans)
