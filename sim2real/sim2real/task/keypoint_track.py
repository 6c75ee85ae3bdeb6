"""Keypoints of a recording, and the stretches in which the object that they are of rests."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from np_description.keypoints import COUNT
from sim2real.recordings.reading import SECOND, ContractViolation, bag_violation
from sim2real.thresholds import THRESHOLDS

TRACK = THRESHOLDS.keypoint_track


@dataclass(frozen=True, eq=False)
class KeypointTrack:
    """Keypoints of n images. Raises ContractViolation for arrays of another shape, or stamps that do not increase."""

    name: str
    """Recording."""
    time: np.ndarray
    """Times (n,) s from the first image, increasing."""
    pixels: np.ndarray
    """Corners (n, 8, 2) u, v px."""
    usable: np.ndarray
    """Whether (n, 8) a corner has the score that policies require."""

    def __post_init__(self) -> None:
        n = len(self.time)
        if n < TRACK.least or self.pixels.shape != (n, COUNT, 2) or self.usable.shape != (n, COUNT):
            raise ContractViolation(
                f"{self.name}: expected keypoints (n, {COUNT}, 2) of {TRACK.least} images or more, got "
                f"{n} stamps, pixels {self.pixels.shape}, usable {self.usable.shape}"
            )
        if not (np.isfinite(self.time).all() and np.isfinite(self.pixels[self.usable]).all()):
            raise ContractViolation(f"{self.name}: expected finite stamps and keypoints, got some that are not")
        if (np.diff(self.time) <= 0).any():
            row = int(np.argmax(np.diff(self.time) <= 0)) + 1
            raise ContractViolation(
                f"{self.name}: expected stamps that increase, got one that does not, in image {row}"
            )

    @property
    def period(self) -> float:
        """s between images, in the median."""
        return float(np.median(np.diff(self.time)))


def read_keypoint_track(path: str | Path) -> KeypointTrack:
    """The keypoints of a rosbag2 recording. Raises ContractViolation."""
    from np_description.message_arrays import keypoints_array
    from np_record.bag import BagError, MissingTopics, Recording  # slow

    name = f"bag {Path(path)}"
    try:
        with Recording(path, required=("keypoints",)) as recording:
            stamps, found = (np.array(column) for column in zip(*recording.read("keypoints", keypoints_array)))
    except MissingTopics as error:
        raise ContractViolation(f"{error}{_other_suite(error.information)}") from error
    except BagError as error:
        raise bag_violation(path, error) from error
    if not len(stamps):
        raise ContractViolation(f"{name}: expected keypoints, got none")
    return KeypointTrack(name, (stamps - stamps[0]) / SECOND, found[:, :, :2], found[:, :, 2] >= TRACK.score)


def _other_suite(information: dict) -> str:
    """Of a bag of the arm's experiments: which command records keypoints."""
    is_arms = "experiments" in information and "suite" not in information
    return "; `excite --suite task` records keypoints" if is_arms else ""


def find_rests(track: KeypointTrack) -> list[slice]:
    """Stretches of images in which the object rests, each of `TRACK.rest` s and more without a gap.

    It moves where the median corner of the images after an image lies elsewhere than of those before it, by more than noise leaves.
    Corners that are not usable, or wrong, are few: medians pass them over.
    """
    pixels = np.where(track.usable[..., None], track.pixels, np.nan)
    late = np.r_[True, np.diff(track.time) > TRACK.gap * track.period]
    margin = round(TRACK.trim / track.period)
    found = []
    for piece in _split_at_motion(slice(0, len(pixels)), _detect_motion(pixels, TRACK.window), late):
        inside = slice(piece.start + margin, max(piece.start, piece.stop - margin))
        slow = np.zeros(len(pixels), bool)  # slow ways show in longer windows alone
        slow[inside] = _detect_motion(pixels[inside], TRACK.slow * TRACK.window)
        found += _split_at_motion(inside, slow, late)
    return [s for s in found if track.time[s.stop - 1] - track.time[s.start] >= TRACK.rest]


def _split_at_motion(within: slice, moving: np.ndarray, late: np.ndarray) -> list[slice]:
    """Stretches of some images in which nothing moves (n,) and none is late (n,)."""
    if within.stop <= within.start:
        return []
    begins = (np.r_[True, np.diff(moving.astype(int)) != 0] | late)[within]
    edges = within.start + np.r_[np.flatnonzero(np.r_[True, begins[1:]]), within.stop - within.start]
    return [slice(a, b) for a, b in zip(edges[:-1].tolist(), edges[1:].tolist()) if not moving[a]]


def _detect_motion(pixels: np.ndarray, half: int) -> np.ndarray:
    """Images (n,) of two windows of `half` one after the other, whose medians differ by more than they usually do."""
    moving = np.zeros(len(pixels), bool)
    if len(pixels) < 2 * half + 1:
        return moving
    windows = np.lib.stride_tricks.sliding_window_view(pixels, half, axis=0)  # (n - half + 1, 8, 2, half)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a corner that is never usable has no median
        medians = np.nanmedian(windows, axis=-1)
        step = np.linalg.norm(np.nanmedian(medians[half:] - medians[:-half], axis=1), axis=1)  # of all corners together
        # As if it rested all the time, which it does not: what noise alone makes of it is the most. A second difference has little of
        # motion, and of noise as much as a first one, times the root of three.
        usual = np.nanquantile(step, TRACK.resting) / np.sqrt(-2 * np.log(1 - TRACK.resting))
        bends = np.nanmedian(np.abs(np.diff(pixels, n=2, axis=0))) / np.sqrt(3)
        usual = min(usual, TRACK.calm * bends)
    for row in np.flatnonzero(~(step < max(TRACK.still, TRACK.surely * usual))):
        moving[row : row + 2 * half] = True
    return moving
