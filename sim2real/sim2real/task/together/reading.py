"""What is read for all stages together: recordings of one set-up."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from np_description.camera import CAMERA, Camera
from sim2real.recordings.reading import ContractViolation
from sim2real.task.camera.places import read_places
from sim2real.task.suite.covered import uncovered
from sim2real.task.suite.recording import NoSuite, TaskRecording, read_task
from sim2real.task.together.whole import Seen
from sim2real.task.track import read_track


def read_seen(
    bags: Sequence[str | Path], calibration: str = "", measured: bool = True, camera: Camera = CAMERA
) -> Seen:
    """Rosbag2 recordings in the order of time; calibration, measured: as of `read_places`; camera: that is believed in. Raises ContractViolation for
    one that has no keypoints, or is of another object than the first."""
    tasks, tracks, places = [], [], []
    for bag in bags:
        try:
            tasks.append(uncovered(read_task(bag), camera))
            tracks.append(tasks[-1].track)
        except NoSuite:  # an episode: it is seen, and not felt
            tracks.append(read_track(bag))
        places += read_places(bag, calibration, measured, tracks[-1])
    _of_one_object(tasks)
    return Seen(tuple(tasks), tuple(tracks), tuple(places))


def read_held_out(bags: Sequence[str | Path], seen: Seen) -> tuple[TaskRecording, ...]:
    """Further recordings of the task suite, of which no stage shall hear. Raises ContractViolation for one that is none, or of another object."""
    fresh = tuple(read_task(bag) for bag in bags)
    _of_one_object([*seen.tasks, *fresh])
    return fresh


def _of_one_object(tasks: Sequence[TaskRecording]) -> None:
    for task in tasks[1:]:
        if task.domain.half_size != tasks[0].domain.half_size:
            raise ContractViolation(f"{task.log.name}: expected the object of {tasks[0].log.name}, got another")
