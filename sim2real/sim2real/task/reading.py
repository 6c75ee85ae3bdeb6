"""Recordings of one set-up, read for all stages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from np_description.camera import CAMERA, Camera
from sim2real.recordings.reading import ContractViolation, load_bag
from sim2real.task.camera.rest_poses import read_rest_poses
from sim2real.task.diagnosis import TaskRecordings
from sim2real.task.keypoint_track import read_keypoint_track
from sim2real.task.suite.occlusion import mask_occluded_keypoints
from sim2real.task.suite.recording import NotATaskSuite, TaskRecording, read_task


def read_recordings(
    bags: Sequence[str | Path], calibration: str = "", measured: bool = True, camera: Camera = CAMERA
) -> TaskRecordings:
    """Rosbag2 recordings in the order of time; calibration, measured: as of `read_rest_poses`; camera: the nominal one. Raises ContractViolation for
    one that has no keypoints, or is of another object than the first."""
    tasks, tracks, rest_poses, logs = [], [], [], []
    for bag in bags:
        logs.append(load_bag(bag))
        try:
            tasks.append(mask_occluded_keypoints(read_task(bag, logs[-1]), camera))
            tracks.append(tasks[-1].track)
        except NotATaskSuite:  # an episode: it is seen, and not felt
            tracks.append(read_keypoint_track(bag))
        rest_poses += read_rest_poses(bag, calibration, measured, tracks[-1])
    _of_one_object(tasks)
    return TaskRecordings(tuple(tasks), tuple(tracks), tuple(rest_poses), tuple(logs))


def read_held_out(bags: Sequence[str | Path], recordings: TaskRecordings) -> tuple[TaskRecording, ...]:
    """Further recordings of the task suite, which no stage uses. Raises ContractViolation for one that is none, or of another object."""
    fresh = tuple(read_task(bag, load_bag(bag)) for bag in bags)
    _of_one_object([*recordings.tasks, *fresh])
    return fresh


def _of_one_object(tasks: Sequence[TaskRecording]) -> None:
    for task in tasks[1:]:
        if task.domain.half_size != tasks[0].domain.half_size:
            raise ContractViolation(f"{task.log.name}: expected the object of {tasks[0].log.name}, got another")
