"""An object that the tip pushes: its path, and the end of the push, where the tip rests against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_common.rotations import matrix_from_quaternion, matrix_from_vector, quaternion_from_matrix
from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA, Camera
from np_description.domains import Pose
from np_description.keypoints import box_keypoints
from sim2real.recordings.reading import ContractViolation
from sim2real.task.suite.object_pose import pose_between
from sim2real.task.suite.recording import TaskRecording
from sim2real.thresholds import THRESHOLDS

LATENCY = THRESHOLDS.image_latency
STEP = 1e-4  # m, rad, of a derivative


@dataclass(frozen=True, eq=False)
class PushEnd:
    """The tip at rest at the end of a push, against the object."""

    ahead: np.ndarray
    """Direction (3,) of the push."""
    begin: float
    """Time s at which the tip is down."""
    stop: float
    """Time s at which the tip has arrived."""
    leaves: float
    """Time s at which the tip leaves."""
    rows: np.ndarray
    """Rows of the log in which the tip rests."""
    time: np.ndarray
    """Times (n,) s of the whole experiment."""
    tip: np.ndarray
    """Path (n, 3) m of T_E."""
    at: np.ndarray
    """Mean position (3,) m of T_E at rest."""
    pose: Pose
    """Pose of the object then."""


def find_push_end(recording: TaskRecording, name: str, camera: Camera = CAMERA) -> PushEnd | None:
    """The end of a push; None where the object is not seen then."""
    log, rows = recording.log, recording.rows(name)
    time, tip = log.time[rows], forward_kinematics(log.position[rows])[0]
    low = tip[:, 2] < tip[:, 2].min() + LATENCY.down
    begin = int(np.argmax(low))
    away = np.linalg.norm(tip[:, :2] - tip[begin, :2], axis=1) * low
    far = np.flatnonzero(away > away.max() - LATENCY.rested)
    stop, leaves = float(time[far[0]]), float(time[far[-1]])
    ahead = (tip[far[0]] - tip[begin]) * (1.0, 1.0, 0.0)
    ahead /= max(float(np.linalg.norm(ahead)), 1e-6)
    try:
        pose = pose_between(recording, stop + LATENCY.settle, leaves, camera)
    except ContractViolation:
        return None
    at = tip[far].mean(axis=0)
    return PushEnd(ahead, float(time[begin]), stop, leaves, rows.start + far, time, tip, at, pose)


@dataclass(frozen=True, eq=False)
class PushedObject:
    """The path of an object that the tip pushes, beside the path of the tip."""

    name: str
    """Experiment."""
    time: np.ndarray
    """Times (n,) s of the images."""
    way: np.ndarray
    """Position (n,) m of the touched place along the push, from where it came to rest."""
    at: np.ndarray
    """Times (m,) s of the tip's path."""
    tip: np.ndarray
    """Position (m,) m of the tip along the push, from where it came to rest."""
    row: float = 0.0
    """Image row of the object, as a share of the image height below its middle."""
    periods: int = 0
    """Periods of an oscillating push, whose object may stay behind where the tip turns back; 0 for a plain push."""

    @property
    def counts(self) -> int:
        """Pushes that it counts as: its periods, or one."""
        return max(self.periods, 1)


def track_displacement(recording: TaskRecording, images: np.ndarray, rest: Pose, ahead: np.ndarray, camera: Camera):
    """Displacement (n,) m of the object along `ahead` (3,) from its rest pose and rotation (n,) rad, from the corners of each image; NaN where
    too few are usable."""
    half = np.asarray(recording.domain.half_size)
    across, found = np.array([-ahead[1], ahead[0], 0.0]), np.full((len(images), 2), np.nan)

    def project(x: np.ndarray) -> np.ndarray:
        turn = matrix_from_vector(np.array([0.0, 0.0, x[2]])) @ matrix_from_quaternion(rest.quaternion)
        corners = box_keypoints(half, rest.position + x[0] * ahead + x[1] * across, quaternion_from_matrix(turn))
        return camera.project(corners)[0]

    for row, image in enumerate(images):
        usable = recording.track.usable[image]
        if usable.sum() < LATENCY.corners:
            continue
        pixels = recording.track.pixels[image]

        def off(x: np.ndarray, pixels=pixels, usable=usable) -> np.ndarray:
            return (project(x) - pixels)[usable].ravel()

        x, weights = np.zeros(3), np.ones(2 * usable.sum())
        # Gauss and Newton: the picture is nearly a plane; a corner that is found wrongly counts less.
        for _ in range(5):
            here = off(x)
            columns = np.column_stack([(off(x + STEP * unit) - here) / STEP for unit in np.eye(3)])
            x = x - np.linalg.lstsq(columns * weights[:, None], here * weights, rcond=None)[0]
            far = np.linalg.norm(off(x).reshape(-1, 2), axis=1)
            weights = np.repeat(np.sqrt(np.minimum(1.0, LATENCY.wrong / np.maximum(far, 1e-9))), 2)
        found[row] = x[0], x[2]
    return found.T


def mean_image_row(recording: TaskRecording, images: np.ndarray, camera: Camera) -> float:
    """Mean image row of the object, as a share of the image height below the middle."""
    track = recording.track
    return float(track.pixels[images][track.usable[images]][:, 1].mean() - camera.cy) / camera.height
