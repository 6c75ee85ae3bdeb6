"""What a recording shows of a calibration board: where the arm rested, and the corners seen there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from np_control.kinematics import forward_kinematics
from np_description.calibration import Lens
from np_description.message_arrays import image_array
from np_description.panda import JOINT_NAMES
from np_perception.calibration.board import Board, BoardDetection, undistort
from np_perception.calibration.bundle import BoardView
from np_perception.camera.recorded_lens import read_lenses
from np_record.bag import Recording
from np_record.bulk import read_joint_states

RESTING = 0.01  # rad/s, of every joint
REST_BEFORE = 0.3  # s without movement before a posture counts: the mount stops swinging
SHORTEST = 0.5  # s
SAME_POSTURE = 0.02  # rad, within which a rest goes on
MAX_DISAGREEMENT = 0.5  # of the images of a rest may disagree with each other on a corner, px


class CalibrationRefusal(ValueError):
    """Recordings from which no camera can be calibrated; the message names what is missing."""


@dataclass(frozen=True, eq=False)
class StillPosture:
    """A posture at which the arm stood still. begin, end: ns; joints (7,) rad, their mean."""

    begin: int
    end: int
    joints: np.ndarray


@dataclass(frozen=True, eq=False)
class CalibrationData:
    """What a recording shows."""

    lens: Lens
    """Of its images."""
    turn: np.ndarray
    """Rotation (3, 3) by which they had been turned."""
    rests: list[StillPosture]
    """Postures at which the arm rested."""
    detections: list[tuple[int, BoardDetection]]
    """Number of the rest, and what was found in an image taken then."""
    images: int
    """How many images were looked at: those taken while the arm rested."""
    markers: set[int]
    """Numbers of all markers seen."""
    taken: np.ndarray
    """Stamps (n,) ns of all images."""
    is_legacy: bool
    """Whether the board is of OpenCV's layout before 4.6."""


def find_still_postures(stamps: np.ndarray, positions: np.ndarray, velocities: np.ndarray) -> list[StillPosture]:
    """When the arm stood still: stamps (n,) ns, positions (n, 7) rad, velocities (n, 7) rad/s."""
    still = (np.abs(velocities) < RESTING).all(axis=1)
    rests, begin = [], None
    for i in range(len(stamps) + 1):
        goes_on = (
            i < len(stamps)
            and still[i]
            and (begin is None or np.abs(positions[i] - positions[begin]).max() < SAME_POSTURE)
        )
        if goes_on:
            begin = i if begin is None else begin
        elif begin is not None:
            since = stamps[begin] + round(REST_BEFORE * 1e9)
            if stamps[i - 1] - since >= SHORTEST * 1e9:
                inside = slice(np.searchsorted(stamps, since), i)
                rests.append(StillPosture(int(since), int(stamps[i - 1]), positions[inside].mean(axis=0)))
            begin = i if i < len(stamps) and still[i] else None
    return rests


def read_calibration_data(
    path: str | Path, board: Board, progress: Callable[[int, int], None] = lambda done, total: None
) -> CalibrationData:
    """Look for the board in the images that were taken while the arm rested.

    A board of OpenCV's layout before 4.6, which begins with a white square where it has an even number of rows, is looked for too.
    Raises BagError for a recording that is broken, lacks a topic or has messages that mean nothing; CalibrationRefusal for a camera that
    changes.
    """
    with Recording(path, required=("joint_states", "camera/image_raw", "camera/camera_info")) as recording:
        stamps, values = read_joint_states(f"bag {path}", recording.rows("joint_states")["joint_states"], JOINT_NAMES)
        lenses = [*read_lenses(recording)]
        lens, turn = lenses[0]
        if any(other != lens or not np.allclose(turned, turn) for other, turned in lenses):
            raise CalibrationRefusal(f"bag {path}: expected one camera_info, it changes during the recording")
        rests = find_still_postures(stamps, values[:, 0], values[:, 1])
        looks = {False: replace(board, is_legacy=False), True: replace(board, is_legacy=True)}
        detections: dict[bool, list[tuple[int, BoardDetection]]] = {False: [], True: []}
        markers, images, taken = set(), 0, []
        for stamp, image in recording.read("camera/image_raw", image_array):
            taken.append(stamp)
            progress(len(taken), recording.counts["camera/image_raw"])
            at = [i for i, rest in enumerate(rests) if rest.begin <= stamp <= rest.end]
            if not at:
                continue
            if image.shape[:2] != (lens.height, lens.width):
                raise CalibrationRefusal(
                    f"bag {path}: expected images of {lens.width} x {lens.height} as in camera_info, "
                    f"got {image.shape[1]} x {image.shape[0]}"
                )
            images += 1
            for is_legacy, look in looks.items():
                found = look.detect(image)
                markers.update(found.markers.tolist())
                if found.is_usable:
                    detections[is_legacy].append((at[0], found))
                    break
    is_legacy = len(detections[True]) > len(detections[False])
    return CalibrationData(lens, turn, rests, detections[is_legacy], images, markers, np.array(taken), is_legacy)


def average_detections(detections: Sequence[BoardDetection], board: Board, lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) m and undistorted pixels (n, 2) of the corners that at least half of the images show,
    each its median.

    Corners on which the images disagree, because something moved, are left out.
    """
    points, pixels = [], []
    for corner in np.unique(np.concatenate([detection.ids for detection in detections])):
        seen = np.concatenate([detection.pixels[detection.ids == corner] for detection in detections])
        middle = np.median(seen, axis=0)
        if len(seen) * 2 >= len(detections) and np.abs(seen - middle).max() < MAX_DISAGREEMENT:
            points.append(board.corners[corner])
            pixels.append(middle)
    return np.array(points).reshape(-1, 3), undistort(np.array(pixels).reshape(-1, 2), lens)


def board_views(evidence: CalibrationData, board: Board, *, in_hand: bool) -> list[BoardView]:
    """One view for each posture at which the board was seen; the carrier of the board is the hand (T_E) or
    the table."""
    views = []
    for number, rest in enumerate(evidence.rests):
        seen = [detection for i, detection in evidence.detections if i == number]
        if not seen:
            continue
        points, pixels = average_detections(seen, board, evidence.lens)
        if BoardDetection(np.arange(len(points)), pixels, np.zeros(0)).is_usable:
            carrier = forward_kinematics(rest.joints) if in_hand else (np.zeros(3), np.eye(3))
            views.append(BoardView(*carrier, points, pixels))
    return views
