"""How fast an object comes to rest that was tapped: by friction over mass, where a push and a drag feel friction alone.

The object leaves the tip where that slows down faster than friction slows the object. So it comes to rest at the farthest of all the places that
it would reach from the tip, at the tip's speed: where it lies then gives its deceleration. By its own weight alone it stops at mu g, whatever
its mass; something else that presses it onto the table stops it sooner.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA, Camera
from sim2real.excitation.contact_suite.tip import BEYOND
from sim2real.excitation.contact_suite.workspace import RestingObject
from sim2real.recordings.reading import ContractViolation
from sim2real.task.suite.hand_eye_offset import HandEyeOffset
from sim2real.task.suite.object_pose import pose_between
from sim2real.task.suite.recording import TaskRecording
from sim2real.task.wrench import leading_corner
from sim2real.thresholds import THRESHOLDS

SLIDE = THRESHOLDS.tap_slides


@dataclass(frozen=True, eq=False)
class TapSlide:
    """A tap, and where the object came to rest."""

    name: str
    """Experiment."""
    along: np.ndarray
    """Path (n,) m of the tip in the direction of the tap."""
    speed: np.ndarray
    """Speed (n,) m/s of the tip."""
    rest_position: float
    """Position m of the object's face at rest, on that path."""

    def short(self, slows: float) -> float:
        """m by which the object came to rest sooner than friction of `fit_deceleration` m/s^2 has it."""
        return float(np.max(self.along + self.speed**2 / (2 * slows))) - self.rest_position


def fit_deceleration(of: Sequence[TapSlide]) -> float:
    """m/s^2 that explain slides together, within the given bounds."""
    return float(
        np.exp(minimize_scalar(lambda x: sum(one.short(np.exp(x)) ** 2 for one in of), bounds=np.log(SLIDE.slows)).x)
    )


def find_tap_slides(recording: TaskRecording, meeting: HandEyeOffset, camera: Camera = CAMERA) -> list[TapSlide]:
    """Of all taps of a recording. meeting: by how much faces are seen off; none without. camera: see `seen.over`."""
    return [] if meeting.numbers is None else list(_find_slides(recording, meeting, camera))


def _find_slides(recording: TaskRecording, meeting: HandEyeOffset, camera: Camera) -> Iterator[TapSlide]:
    for name in recording.named("tap"):
        rows = recording.rows(name)
        time = recording.log.time[rows]
        position, turn = forward_kinematics(recording.log.position[rows])
        tip = position + turn @ np.array([0.0, 0.0, BEYOND])
        down = np.flatnonzero(tip[:, 2] < tip[:, 2].min() + SLIDE.down)
        begin, end = down[0], down[-1]
        ahead = (tip[down[np.linalg.norm((tip[down] - tip[begin])[:, :2], axis=1).argmax()]] - tip[begin]) * (1, 1, 0)
        ahead /= max(float(np.linalg.norm(ahead)), 1e-6)
        try:
            resting = RestingObject.of(recording.domain, pose_between(recording, time[end], time[-1], camera))
        except ContractViolation:
            continue
        normal, distance = min(resting.sides(), key=lambda one: float(one[0] @ ahead[:2]))
        square = -float(normal @ ahead[:2])
        if square < SLIDE.square:
            continue
        edge = leading_corner(ahead, turn[begin:end], tip[begin:end])
        along = edge @ ahead
        speed = np.maximum(np.gradient(along, time[begin:end]), 0.0)
        # The face along the tip's line, where the hand would meet it.
        lead = edge[along.argmax()]
        contact = distance + meeting.off(normal) - float((lead[:2] - resting.centre[:2]) @ normal)
        yield TapSlide(name, along, speed, float(lead @ ahead) - contact / square)
