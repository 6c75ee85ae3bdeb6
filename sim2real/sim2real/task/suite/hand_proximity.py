"""When the hand is at the object: by where the hand was and where the object is seen, whatever an experiment is called and how often it is made."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA, Camera
from np_description.keypoints import COUNT
from sim2real.excitation.contact_suite.tip import RADIUS, lowest_corner
from sim2real.excitation.contact_suite.workspace import RestingObject
from sim2real.recordings.reading import ContractViolation
from sim2real.task.keypoint_track import KeypointTrack
from sim2real.task.suite.object_pose import pose_between
from sim2real.task.suite.recording import TaskRecording
from sim2real.thresholds import THRESHOLDS

STATIC, MOTION = THRESHOLDS.static_scene, THRESHOLDS.object_motion
RATE = 100.0  # rows a second of the hand's way
FIRST = 1.0  # s, of images that show how the object lies


@dataclass(frozen=True, eq=False)
class HandTrajectory:
    """When the hand may touch the object."""

    time: np.ndarray
    """Times (n,) s of the log."""
    is_near: np.ndarray
    """Whether (n,) the hand may touch the object."""
    speed: np.ndarray
    """Speed (n,) m/s of the tip along the table."""

    @property
    def touching(self) -> list[tuple[float, float]]:
        """(begin, end) s between which it may touch the object, and what it does to it is seen."""
        return self._stretches(self.is_near)

    @property
    def quick(self) -> list[tuple[float, float]]:
        """(begin, end) s between which it moves the object faster than a step of the picture is judged by, and what it does is seen."""
        moves = self._stretches(self.is_near & (self.speed > STATIC.slow))
        return [(begin - STATIC.early, end) for begin, end in moves]

    def _stretches(self, rows: np.ndarray) -> list[tuple[float, float]]:
        found = np.flatnonzero(rows)
        pieces = np.split(found, np.flatnonzero(np.diff(found) > 1) + 1) if len(found) else []
        return [(float(self.time[one[0]]), float(self.time[one[-1]]) + MOTION.after) for one in pieces]


def hand_trajectory(recording: TaskRecording, camera: Camera = CAMERA, lift: float = 0.0) -> HandTrajectory:
    """Of a recording of the task suite. lift: m by which the table was felt to be higher; camera: as it looks at that table (`seen.over`).

    The hand is near where the tip's end is no higher than `STATIC.above` over the object's top, and no farther than
    `STATIC.beside` from the circle about the object. The housing is not checked: the suite lets it pass tall objects.
    Raises ContractViolation where the object is not seen at first.
    """
    log, begin = recording.log, recording.seen_from
    resting = RestingObject.of(recording.domain, pose_between(recording, begin, begin + FIRST, camera))
    rows = slice(None, None, max(1, round(1 / RATE / float(np.median(np.diff(log.time))))))
    time, (position, turn) = log.time[rows], forward_kinematics(log.position[rows])
    times, middle = _object_centres(recording, camera, resting.height / 2)
    away = np.hypot(*(position[:, axis] - np.interp(time, times, middle[:, axis]) for axis in range(2)))
    low = lowest_corner(position, turn)[:, 2] < lift + resting.height + STATIC.above
    along = np.gradient(position[:, :2], time, axis=0)
    return HandTrajectory(time, low & (away < resting.reach + RADIUS + STATIC.beside), np.hypot(*along.T))


def mask_touched_images(recording: TaskRecording, camera: Camera = CAMERA) -> KeypointTrack:
    """The track, of whose images none counts in which the hand is at the object; all of it where the object is not seen at first."""
    track = recording.track
    try:
        touching = hand_trajectory(recording, camera).touching
    except ContractViolation:
        return track
    taken, usable = track.time + recording.seen_from, track.usable.copy()
    for begin, end in touching:
        usable[(taken >= begin) & (taken < end)] = False
    return replace(track, usable=usable)


def _object_centres(recording: TaskRecording, camera: Camera, height: float) -> tuple[np.ndarray, np.ndarray]:
    """s of the log (n,) and places (n, 2) m of the object's middle, `height` m over the table, of images that show all corners well enough."""
    track = recording.track
    known = track.usable.sum(axis=1) >= STATIC.corners
    corner_indices = [c for c in range(COUNT) if track.usable[:, c].any()]
    if not known.any() or not corner_indices:
        raise ContractViolation("the object is not seen")
    # All of them, or the middle goes.
    corners = [interpolate_hidden(track.time, track.pixels[:, c], track.usable[:, c]) for c in corner_indices]
    pixels = np.mean(corners, axis=0)[known]
    pixels = median_filter(pixels, size=(STATIC.window, 1), mode="nearest")  # a corner that is found wrongly
    return track.time[known] + recording.seen_from, camera.at_height(camera.rays(pixels), height)


def interpolate_hidden(time: np.ndarray, pixels: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) of a corner; while it is hidden it goes straight from where it was to where it is afterwards, by medians of some images."""
    known = median_filter(pixels[usable], size=(STATIC.window, 1), mode="nearest")
    between = np.column_stack([np.interp(time, time[usable], axis) for axis in known.T])
    return np.where(usable[:, None], pixels, between)
