"""Where the hand meets the object against where it is seen: is the camera elsewhere, or the object larger?

A tip that has pushed a face and rests on it knows where the face is. What it is seen off by is the same way in the base frame whichever face
is pushed, if the picture is off; it is outwards on every face, if the object is larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA, Camera
from np_diagnosis.chain.contact_force import side
from np_diagnosis.chain.explanations import Explained, Measured, explain
from np_diagnosis.chain.task.led import rested
from np_diagnosis.chain.task.recording import TaskRecording
from np_diagnosis.experiments.task.room import Lain
from np_diagnosis.experiments.task.tip import BEYOND
from np_diagnosis.thresholds import THRESHOLDS

MEET = THRESHOLDS.meeting
NUMBERS = ("x", "y", "size")
"""m: by which things are seen off in the base frame, and by which an edge of the object is longer."""
EFFECTS = {"picture": ("x", "y"), "object_size": ("size",)}


@dataclass(frozen=True, eq=False)
class Met:
    """A face. normal (2,): outwards; gap m: from where the face is seen to the tip that rests on it."""

    name: str
    normal: np.ndarray
    gap: float


@dataclass(frozen=True, eq=False)
class Meeting:
    """verdict: as of Explained, or unexplained; doubt: why nothing is said. faces: that were met. left: m, root mean square that no
    explanation takes off."""

    verdict: str
    explained: Explained | None
    faces: tuple[Met, ...]
    doubt: str = ""
    left: float | None = None


def meet(recording: TaskRecording, camera: Camera = CAMERA, lift: float = 0.0) -> Meeting:
    """Of the slow pushes of a recording. lift: m, the table's height as it was felt, by which the picture shows things elsewhere."""
    faces = (_met(recording, name, camera, lift) for name in recording.named("push"))
    return judge(tuple(face for face in faces if face is not None))


def judge(faces: tuple[Met, ...]) -> Meeting:
    """Of faces: see `meet`."""
    if len(faces) < MEET.least:
        return Meeting("undetermined", None, faces, f"{len(faces)} faces were met; {MEET.least} are needed")
    columns = np.array([[-n.normal[0], -n.normal[1], 0.5] for n in faces])
    gaps = np.array([n.gap for n in faces])
    usual, gap = (np.array(v) for v in zip(MEET.picture, MEET.picture, MEET.size))
    before = np.diag(1 / (usual**2 + gap**2))
    precision = columns.T @ columns / MEET.face**2
    value = np.linalg.solve(precision + before, columns.T @ gaps / MEET.face**2)
    left = float(np.sqrt(np.mean((gaps - columns @ value) ** 2)))
    if left > MEET.left:
        return Meeting("unexplained", None, faces, f"faces are met {1e3 * left:.1f} mm off any place and size", left)
    # Of numbers that no face narrows, what was measured is nothing at all.
    covariance = np.linalg.inv(precision + 1e-6 * before) * max(1.0, (left / MEET.face) ** 2)
    measured = covariance @ (columns.T @ gaps / MEET.face**2) / max(1.0, (left / MEET.face) ** 2)
    covariance = covariance + np.diag([MEET.common**2, MEET.common**2, 0.0])
    explained = explain(Measured(NUMBERS, measured, covariance, usual, gap, EFFECTS))
    return Meeting(explained.verdict, explained, faces, "", left)


def _met(recording: TaskRecording, name: str, camera: Camera, lift: float) -> Met | None:
    """The face on which the tip of a push rests in the end; None where it does not, or is not seen."""
    rest = rested(recording, name, camera)
    if rest is None:
        return None
    lain = Lain.of(recording.domain, rest.pose)
    outward = [(float(normal @ rest.ahead[:2]), normal, distance) for normal, distance in lain.sides()]
    along, normal, distance = min(outward, key=lambda one: one[0])
    if -along < MEET.square:
        return None
    position, turn = forward_kinematics(recording.log.position[rest.rows])
    tip = position + turn @ np.array([0.0, 0.0, BEYOND])
    point = side(rest.ahead, turn, tip).mean(axis=0)[:2]
    # Higher things are seen farther from the camera's foot than they are.
    seen = lain.centre[:2] - lift * (lain.centre[:2] - camera.position[:2]) / (camera.position[2] - lain.centre[2])
    return Met(name, normal, float((point - seen) @ normal - distance))
