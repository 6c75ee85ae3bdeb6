"""The end of a push: the tip rests at the farthest of its way, and the object against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA, Camera
from np_description.domains import Pose
from np_diagnosis.chain.task.recording import TaskRecording
from np_diagnosis.chain.task.seen import pose_between
from np_diagnosis.recordings.reading import ContractViolation
from np_diagnosis.thresholds import THRESHOLDS

LAG = THRESHOLDS.lag


@dataclass(frozen=True, eq=False)
class Rest:
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


def rested(recording: TaskRecording, name: str, camera: Camera = CAMERA) -> Rest | None:
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
    return Rest(ahead, float(time[begin]), stop, leaves, rows.start + far, time, tip, at, pose)
