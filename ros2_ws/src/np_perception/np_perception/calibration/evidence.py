"""What a recording shows of a calibration board: where the arm rested, and the corners seen there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from np_control.kinematics import forward_kinematics
from np_description.calibration import Lens
from np_description.message_arrays import BadMessage, camera_info_lens, image_array, joint_state_arrays
from np_description.panda import STATE_NAMES
from np_perception.calibration.board import Board, BoardDetection, undistort
from np_perception.calibration.bundle import BoardView
from np_record.bag import Recording

RESTING = 0.01  # rad/s, of every joint
REST_BEFORE = 0.3  # s without movement before a posture counts: the mount stops swinging
SHORTEST = 0.5  # s
SAME_POSTURE = 0.02  # rad, within which a rest goes on
MAX_DISAGREEMENT = 0.5  # of the images of a rest may disagree with each other on a corner, px


class CalibrationRefusal(ValueError):
    """Recordings from which no camera can be calibrated; the message says what is missing."""


@dataclass(frozen=True, eq=False)
class StillPosture:
    """A posture at which the arm stood still. begin, end: ns; joints (7,) rad, their mean."""

    begin: int
    end: int
    joints: np.ndarray


@dataclass(frozen=True, eq=False)
class CalibrationData:
    """What a recording shows. lens: of its images; turn (3, 3): by which they had been turned; rests;
    detections with the rest, by number, at which each was made; images: how many were looked at; markers:
    numbers of all markers seen.
    """

    lens: Lens
    turn: np.ndarray
    rests: list[StillPosture]
    detections: list[tuple[int, BoardDetection]]
    images: int
    markers: set[int]


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

    Raises BagError for a recording that is broken or lacks a topic, CalibrationRefusal for messages that mean
    nothing.
    """
    with Recording(path, required=("joint_states", "camera/image_raw", "camera/camera_info")) as recording:
        try:
            states = [
                (message.stamp, *joint_state_arrays(message.decode(), STATE_NAMES)[:2])
                for message in recording.messages("joint_states")
            ]
            lenses = [camera_info_lens(message.decode()) for message in recording.messages("camera/camera_info")]
        except BadMessage as error:
            raise CalibrationRefusal(f"bag {path}: {error}") from error
        lens, turn = lenses[0]
        if any(other != lens or not np.allclose(turned, turn) for other, turned in lenses):
            raise CalibrationRefusal(f"bag {path}: expected one camera_info, it changes during the recording")
        stamps, positions, velocities = (np.array(column) for column in zip(*states))
        rests = find_still_postures(stamps, positions[:, :7], velocities[:, :7])
        detections, markers, images = [], set(), 0
        for number, message in enumerate(recording.messages("camera/image_raw")):
            progress(number + 1, recording.counts["camera/image_raw"])
            at = [i for i, rest in enumerate(rests) if rest.begin <= message.stamp <= rest.end]
            if not at:
                continue
            try:
                image = image_array(message.decode())
            except BadMessage as error:
                raise CalibrationRefusal(f"bag {path}: {error}") from error
            if image.shape[:2] != (lens.height, lens.width):
                raise CalibrationRefusal(
                    f"bag {path}: expected images of {lens.width} x {lens.height} as in camera_info, "
                    f"got {image.shape[1]} x {image.shape[0]}"
                )
            found = board.detect(image)
            images += 1
            markers.update(found.markers.tolist())
            if found.is_usable:
                detections.append((at[0], found))
    return CalibrationData(lens, turn, rests, detections, images, markers)


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
