"""Where the hand meets the object against where it is seen: does the picture show things where they are?

A tip that has pushed a face and rests on it measures where the face is. If the picture is off, it shows every face off by the same way in the base
frame. What is outwards on every face is the object's size, or which part of the hand touches it, and is not reported: that differs by 6 mm between
two engines, one of which has the finger's shaft touch a tall object before its tip does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA, Camera
from sim2real.effects.sentences import ValueWithInterval
from sim2real.excitation.contact_suite.tip import BEYOND
from sim2real.excitation.contact_suite.workspace import RestingObject
from sim2real.task.hypotheses import HypothesisComparison, MeasuredChanges, compare_hypotheses
from sim2real.task.suite.pushed_object import find_push_end
from sim2real.task.suite.recording import TaskRecording
from sim2real.task.wrench import leading_corner
from sim2real.thresholds import THRESHOLDS

OFFSET = THRESHOLDS.hand_eye_offset
NUMBERS = ("x", "y", "out")
"""m: by which things are seen off in the base frame, and by which every face is met farther out than it is seen."""
EFFECTS = {"picture": ("x", "y")}


@dataclass(frozen=True, eq=False)
class FaceContact:
    """A face of the object on which the tip rests."""

    name: str
    """Experiment."""
    normal: np.ndarray
    """Outward normal (2,)."""
    gap: float
    """Distance m from where the face is seen to the tip."""


@dataclass(frozen=True, eq=False)
class HandEyeOffset:
    """By how much the picture is off where the hand touches the object."""

    verdict: str
    """no_gap, identified, ambiguous, unexplained or undetermined."""
    comparison: HypothesisComparison | None
    """Hypotheses for the offset; None where the stage abstains."""
    faces: tuple[FaceContact, ...]
    """Faces that were touched."""
    abstention_reason: str = ""
    """Why the stage abstains."""
    residual: float | None = None
    """Root mean square m that no hypothesis explains."""
    numbers: np.ndarray | None = None
    """Most probable values (3,) m of NUMBERS."""

    def off(self, normal: np.ndarray) -> float:
        """m by which a face with an outward normal (2,) is met farther out than it is seen."""
        return float(np.array([-normal[0], -normal[1], 1.0]) @ self.numbers)


def estimate_hand_eye_offset(recordings: Sequence[TaskRecording], camera: Camera = CAMERA) -> HandEyeOffset:
    """Of the pushes and shoves of recordings of one set-up; objects that lay elsewhere were met from other sides. camera: over the table as it was
    felt, see `camera_over_table`."""
    faces = (_touched_face(recording, name, camera) for recording in recordings for name in recording.pushes())
    return offset_from_faces(tuple(face for face in faces if face is not None))


def offset_from_faces(faces: tuple[FaceContact, ...]) -> HandEyeOffset:
    """Of faces: see `estimate_hand_eye_offset`."""
    if len(faces) < OFFSET.least:
        return HandEyeOffset("undetermined", None, faces, f"{len(faces)} faces were met; {OFFSET.least} are needed")
    columns = np.array([[-n.normal[0], -n.normal[1], 1.0] for n in faces])
    gaps = np.array([n.gap for n in faces])
    usual, gap = (np.array(v) for v in zip(OFFSET.picture, OFFSET.picture, (OFFSET.out, 0.0)))
    before = np.diag(1 / (usual**2 + gap**2))
    precision = columns.T @ columns / OFFSET.face**2
    value = np.linalg.solve(precision + before, columns.T @ gaps / OFFSET.face**2)
    residual = float(np.sqrt(np.mean((gaps - columns @ value) ** 2)))
    if residual > OFFSET.left:
        return HandEyeOffset(
            "unexplained", None, faces, f"faces are met {1e3 * residual:.1f} mm off any place and size", residual
        )
    # Of numbers that no face narrows, what was measured is nothing at all: a little of what is known beforehand keeps it finite.
    inverse = np.linalg.inv(precision + 1e-6 * before)
    covariance = inverse * max(1.0, (residual / OFFSET.face) ** 2) + np.diag([OFFSET.common**2, OFFSET.common**2, 0.0])
    measured = MeasuredChanges(NUMBERS, inverse @ columns.T @ gaps / OFFSET.face**2, covariance, usual, gap, EFFECTS)
    comparison = compare_hypotheses(measured)
    if comparison.findings or not comparison.unidentifiable:
        return HandEyeOffset(comparison.verdict, comparison, faces, "", residual, value)
    bounds = {name: comparison.bounds[name] for name in comparison.unidentifiable}
    known = ", ".join(f"in {name} to {500 * (bound.high - bound.low):.1f} mm" for name, bound in bounds.items())
    reason = f"faces were met from too few sides: the picture is known {known}; record again with the object elsewhere"
    return HandEyeOffset("undetermined", comparison, faces, reason, residual, value)


def camera_shift(offsets: Mapping[str, ValueWithInterval]) -> dict[str, float]:
    """m by axis by which a camera stands elsewhere that shows things off by so much: the other way."""
    return {axis: -offset.value for axis, offset in offsets.items()}


def _touched_face(recording: TaskRecording, name: str, camera: Camera) -> FaceContact | None:
    """The face on which the tip of a push rests in the end; None where it does not, or is not seen."""
    end = find_push_end(recording, name, camera)
    if end is None:
        return None
    resting = RestingObject.of(recording.domain, end.pose)
    outward = [(float(normal @ end.ahead[:2]), normal, distance) for normal, distance in resting.sides()]
    along, normal, distance = min(outward, key=lambda one: one[0])
    if -along < OFFSET.square:
        return None
    position, turn = forward_kinematics(recording.log.position[end.rows])
    tip = position + turn @ np.array([0.0, 0.0, BEYOND])
    point = leading_corner(end.ahead, turn, tip).mean(axis=0)[:2]
    return FaceContact(name, normal, float((point - resting.centre[:2]) @ normal - distance))
