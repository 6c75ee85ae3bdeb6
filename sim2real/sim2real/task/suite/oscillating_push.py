"""An object that the tip presses from above and leads to and fro: for the clock, a push that goes both ways and needs no side to push.

What is seen is the object and not the hand, so that the hand's sinusoid is that of an object that goes with it. A tip that gives way, or slips a little
where it turns back, has play: the object stays behind by as much, which in a sinusoid is nearly a delay, and is fitted with it (`lag`). It rests for a
moment where the tip turns, which no delay does.
"""

from __future__ import annotations

import numpy as np

from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA, Camera
from sim2real.excitation.contact_suite.contact_motions import SWAYS
from sim2real.recordings.reading import ContractViolation
from sim2real.task.suite.object_pose import pose_between
from sim2real.task.suite.pushed_object import PushedObject, mean_image_row, track_displacement
from sim2real.task.suite.recording import TaskRecording
from sim2real.thresholds import THRESHOLDS

LATENCY = THRESHOLDS.image_latency
RATE = 100.0  # rows a second of the tip's way
RESTED = 0.25  # s before the tip leaves, and after, in which the object is seen to rest


def find_oscillating_pushes(recording: TaskRecording, camera: Camera = CAMERA) -> tuple[PushedObject, ...]:
    """Every sway in which the object goes along; none in a recording without, or of an object that does not."""
    return tuple(one for name in recording.named("sway") if (one := _oscillating_push(recording, name, camera)))


def apply_play(tip: np.ndarray, play: float) -> np.ndarray:
    """The way (n,) m of what is led with a play of m to either side of the tip's way (n,) m."""
    at, found = 0.0, []
    for one in tip.tolist():
        at = min(max(at, one - play), one + play)
        found.append(at)
    return np.array(found)


def _oscillating_push(recording: TaskRecording, name: str, camera: Camera) -> PushedObject | None:
    rows, log = recording.rows(name), recording.log
    time, tip = log.time[rows], forward_kinematics(log.position[rows])[0]
    down = np.flatnonzero(tip[:, 2] < tip[:, 2].min() + LATENCY.down)
    leaves = float(time[down[-1]])
    try:
        rest = pose_between(recording, leaves - RESTED, leaves + RESTED, camera)
    except ContractViolation:
        return None
    at = tip[down][time[down] > leaves - RESTED].mean(axis=0)
    aside = (tip[down] - at) * (1.0, 1.0, 0.0)
    ahead = np.linalg.svd(aside, full_matrices=False)[2][0]
    path = aside @ ahead
    goes = time[down][np.abs(path) > 0.1 * np.abs(path).max()]
    # Where the object is within its play is known from the first turn on.
    begin, end = float(goes[0]) + SWAYS[0] / 2, float(goes[-1])
    taken = recording.track.time + recording.seen_from
    images = np.flatnonzero((taken > begin) & (taken < min(end + LATENCY.within, leaves)))
    moved, turned = track_displacement(recording, images, rest, ahead, camera)
    lever = at - rest.position
    moved = (
        moved - np.sin(turned) * float(lever @ [-ahead[1], ahead[0], 0.0]) + (np.cos(turned) - 1) * float(lever @ ahead)
    )
    known = np.isfinite(moved)
    if known.sum() < LATENCY.images or np.ptp(moved[known]) < LATENCY.follows * np.ptp(path):
        return None
    few = slice(None, None, max(1, round(1 / RATE / float(np.median(np.diff(time))))))
    row = mean_image_row(recording, images[known], camera)
    along = (tip - at) @ ahead
    return PushedObject(
        name,
        taken[images[known]],
        moved[known],
        time[few],
        along[few],
        row,
        periods=max(round((end - begin) / SWAYS[0]), 1),
    )
