"""Corners that the hand hides: what a detector reports of them is a guess, and does not count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA, Camera
from np_description.hand import FLAT_HAND
from np_description.panda import NOMINAL
from sim2real.excitation.contact_suite.tip import BEYOND, HALF
from sim2real.excitation.contact_suite.workspace import RestingObject
from sim2real.recordings.reading import ContractViolation
from sim2real.task.keypoint_track import KeypointTrack
from sim2real.task.suite.object_pose import pose_between
from sim2real.task.suite.recording import TaskRecording
from sim2real.thresholds import THRESHOLDS

OCCLUSION = THRESHOLDS.occlusion
_HAND = NOMINAL.frames["hand_tcp"].position[2]
PARTS = (
    ((0.0, 0.0, BEYOND / 2 - 0.02), (HALF[0], 0.022, BEYOND / 2 + 0.02)),  # both fingers, closed
    *((np.subtract(box.centre, (0.0, 0.0, _HAND)), box.half_size) for box in FLAT_HAND.housing),
    ((0.0, 0.0, -_HAND - 0.13), (0.055, 0.055, 0.11)),  # the wrist over the housing
)
"""m: centre and half sides of boxes about parts of the hand, in the frame of T_E."""


def mask_occlusions(
    tasks: Sequence[TaskRecording], tracks: Sequence[KeypointTrack], camera: Camera = CAMERA
) -> tuple[tuple[TaskRecording, ...], tuple[KeypointTrack, ...]]:
    """Recordings, and tracks of which some are theirs, by name, without the corners that the hand hides."""
    found = tuple(mask_occluded_keypoints(task, camera) for task in tasks)
    own = {task.track.name: task.track for task in found}
    return found, tuple(own.get(track.name, track) for track in tracks)


def mask_occluded_keypoints(recording: TaskRecording, camera: Camera = CAMERA) -> TaskRecording:
    """The same, without the corners that the hand hides in an image, or nearly does. They are looked for at the heights at which they lie at first:
    an object that is tipped over by an experiment is not. As it is where the object is not seen at first."""
    track, log = recording.track, recording.log
    try:
        pose = pose_between(recording, recording.seen_from, recording.seen_from + OCCLUSION.first, camera)
    except ContractViolation:
        return recording
    heights = RestingObject.of(recording.domain, pose).corners(np.zeros(2))[:, 2]
    rows = np.clip(np.searchsorted(log.time, track.time + recording.seen_from), 0, len(log.time) - 1)
    position, turn = forward_kinematics(log.position[rows])
    eye = np.asarray(camera.position)
    hidden = np.zeros(track.usable.shape, bool)
    for corner, height in enumerate(heights):
        rays = camera.rays(np.nan_to_num(track.pixels[:, corner]))
        place = eye + rays * ((height - eye[2]) / rays[:, 2])[:, None]
        hidden[:, corner] = _is_behind(eye, place, position, turn)
    return replace(recording, track=replace(track, usable=track.usable & ~hidden))


def _is_behind(eye: np.ndarray, places: np.ndarray, position: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Whether the hand at position (n, 3) m, turned by (n, 3, 3), is between an eye (3,) m and places (n, 3) m."""
    begin = np.einsum("nij,ni->nj", turn, eye - position)
    ray = np.einsum("nij,ni->nj", turn, places - eye)
    found = np.zeros(len(places), bool)
    for centre, half in PARTS:
        wide = np.asarray(half) + OCCLUSION.beside
        with np.errstate(divide="ignore", invalid="ignore"):
            one, other = ((np.asarray(centre) + sign * wide - begin) / ray for sign in (-1.0, 1.0))
        enters, leaves = np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)
        found |= (enters < leaves) & (leaves > 0) & (enters < OCCLUSION.before)
    return found
