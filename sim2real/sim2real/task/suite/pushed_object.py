"""An object that is led by the tip: the end of a push, where the tip rests at the farthest of its way and the object against it, and the way there."""

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

LAG = THRESHOLDS.lag
STEP = 1e-4  # m, rad, of a derivative


@dataclass(frozen=True, eq=False)
class PushEnd:
    """ahead (3,): the push's direction. begin, stop, leaves: s at which the tip is down, has arrived, and leaves. rows: of the log, in which it
    rests; time (n,) s and tip (n, 3) m: the way of T_E in the whole experiment; at (3,) m: its mean at rest. pose: of the object then."""

    ahead: np.ndarray
    begin: float
    stop: float
    leaves: float
    rows: np.ndarray
    time: np.ndarray
    tip: np.ndarray
    at: np.ndarray
    pose: Pose


def find_push_end(recording: TaskRecording, name: str, camera: Camera = CAMERA) -> PushEnd | None:
    """Of a push; None where the object is not seen then."""
    log, rows = recording.log, recording.rows(name)
    time, tip = log.time[rows], forward_kinematics(log.position[rows])[0]
    low = tip[:, 2] < tip[:, 2].min() + LAG.down
    begin = int(np.argmax(low))
    away = np.linalg.norm(tip[:, :2] - tip[begin, :2], axis=1) * low
    far = np.flatnonzero(away > away.max() - LAG.rested)
    stop, leaves = float(time[far[0]]), float(time[far[-1]])
    ahead = (tip[far[0]] - tip[begin]) * (1.0, 1.0, 0.0)
    ahead /= max(float(np.linalg.norm(ahead)), 1e-6)
    try:
        pose = pose_between(recording, stop + LAG.settle, leaves, camera)
    except ContractViolation:
        return None
    at = tip[far].mean(axis=0)
    return PushEnd(ahead, float(time[begin]), stop, leaves, rows.start + far, time, tip, at, pose)


@dataclass(frozen=True, eq=False)
class PushedObject:
    """A push. time (n,) s of images; way (n,) m of the place that the tip touches, along the
    push, from where it came to rest; at (m,) s and tip (m,) m: the tip's way,
    from where that came to rest. row: where in the picture it is seen meanwhile, as a share of the picture's height below its middle; periods:
    of a sway, whose object may stay behind where the tip turns back; 0 of a push. counts: for how many pushes it does."""

    name: str
    time: np.ndarray
    way: np.ndarray
    at: np.ndarray
    tip: np.ndarray
    row: float = 0.0
    periods: int = 0

    @property
    def counts(self) -> int:
        """As many as it has periods, or one."""
        return max(self.periods, 1)


def track_displacement(recording: TaskRecording, images: np.ndarray, rest: Pose, ahead: np.ndarray, camera: Camera):
    """m (n,) by which the object is along `ahead` (3,) from where it rests, and rad (n,) by which it is turned, by the corners of each
    image; NaN where too few are usable."""
    half = np.asarray(recording.domain.half_size)
    across, found = np.array([-ahead[1], ahead[0], 0.0]), np.full((len(images), 2), np.nan)

    def project(x: np.ndarray) -> np.ndarray:
        turn = matrix_from_vector(np.array([0.0, 0.0, x[2]])) @ matrix_from_quaternion(rest.quaternion)
        corners = box_keypoints(half, rest.position + x[0] * ahead + x[1] * across, quaternion_from_matrix(turn))
        return camera.project(corners)[0]

    for row, image in enumerate(images):
        usable = recording.track.usable[image]
        if usable.sum() < LAG.corners:
            continue
        seen = recording.track.pixels[image]

        def off(x: np.ndarray, seen=seen, usable=usable) -> np.ndarray:
            return (project(x) - seen)[usable].ravel()

        x, weights = np.zeros(3), np.ones(2 * usable.sum())
        # Gauss and Newton: the picture is nearly a plane; a corner that is found wrongly counts less.
        for _ in range(5):
            here = off(x)
            columns = np.column_stack([(off(x + STEP * unit) - here) / STEP for unit in np.eye(3)])
            x = x - np.linalg.lstsq(columns * weights[:, None], here * weights, rcond=None)[0]
            far = np.linalg.norm(off(x).reshape(-1, 2), axis=1)
            weights = np.repeat(np.sqrt(np.minimum(1.0, LAG.wrong / np.maximum(far, 1e-9))), 2)
        found[row] = x[0], x[2]
    return found.T


def mean_image_row(recording: TaskRecording, images: np.ndarray, camera: Camera) -> float:
    """Where in the picture the object is seen in images, as a share of the picture's height below its middle."""
    track = recording.track
    return float(track.pixels[images][track.usable[images]][:, 1].mean() - camera.cy) / camera.height
