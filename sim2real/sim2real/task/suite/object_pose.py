"""Where the object is seen to be in a recording of the task suite."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.domains import Pose
from np_perception.pose_estimation import MIN_POINTS, PoseError, estimate_pose
from sim2real.recordings.reading import ContractViolation
from sim2real.task.suite.recording import TaskRecording

IMAGES = 8  # of which the median is taken
GUESSED = 0.3  # score of a corner that is hidden, where too few others are seen for a pose


def camera_over_table(camera: Camera, height: float) -> Camera:
    """The camera as it looks at a table that is higher by m than nominal: it is less high over it. Poses that are seen with it have right x and
    y, and heights over the table."""
    x, y, z = camera.position
    return replace(camera, position=(x, y, z - height))


def pose_at_start(recording: TaskRecording, name: str, camera: Camera = CAMERA) -> Pose:
    """At the beginning of an experiment. Raises ContractViolation where no pose explains the corners."""
    return _pose(recording, recording.images(name)[:IMAGES], name, camera)


def pose_between(recording: TaskRecording, begin: float, end: float, camera: Camera = CAMERA) -> Pose:
    """From the images between two moments, s of the log. Raises ContractViolation where no pose explains the corners."""
    time = recording.track.time + recording.seen_from
    return _pose(recording, np.flatnonzero((time >= begin) & (time < end)), f"{begin:.1f} to {end:.1f} s", camera)


def _pose(recording: TaskRecording, images: np.ndarray, name: str, camera: Camera) -> Pose:
    track = recording.track
    corners = _medians(np.where(track.usable[images][..., None], track.pixels[images], np.nan))
    scores = np.isfinite(corners).all(axis=1).astype(float)
    if scores.sum() < MIN_POINTS:  # the hand hides some: what a detector makes of these counts a little
        scores[scores == 0] = GUESSED
        corners = np.where(np.isfinite(corners), corners, _medians(track.pixels[images]))
        scores *= np.isfinite(corners).all(axis=1)
    found = np.column_stack([np.nan_to_num(corners), scores])
    try:  # it lies flat: to a camera that is turned it looks tilted, and of some pictures a free pose would be nearer, of others not
        return estimate_pose(found, recording.domain, camera=camera, lies=np.inf).pose
    except PoseError as error:
        raise ContractViolation(f"{name}: {error}") from error


def _medians(pixels: np.ndarray) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a corner that is never usable has no median
        return np.nanmedian(pixels, axis=0)
