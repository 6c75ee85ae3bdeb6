"""Places at which the object rested: where its corners were seen there, and where it was if something else measured that."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from np_common.rotations import matrix_from_quaternion
from np_description.domains import Task
from np_description.keypoints import COUNT
from np_description.panda import BASE_FRAME
from sim2real.recordings.reading import SECOND, ContractViolation, bag_violation
from sim2real.task.keypoint_track import KeypointTrack, find_rests, read_keypoint_track
from sim2real.thresholds import THRESHOLDS

PLACES = THRESHOLDS.rest_poses


@dataclass(frozen=True, eq=False)
class RestPose:
    """The object at rest. Raises ContractViolation for arrays of another shape or fewer than PLACES.corners usable corners."""

    name: str
    """Recording and time."""
    pixels: np.ndarray
    """Median (8, 2) px of each corner, NaN where it is not usable."""
    error: np.ndarray
    """Standard error (8,) px of a coordinate, from scatter between images."""
    domain: Task
    """The object and what it may lie on."""
    position: np.ndarray | None = None
    """Position (3,) m in the base frame, measured without the camera; None where nothing measured it."""
    rotation: np.ndarray | None = None
    """Rotation (3, 3) to the base frame, likewise."""
    images: int = 1
    """Images in which it was seen."""

    def __post_init__(self) -> None:
        if self.pixels.shape != (COUNT, 2) or self.error.shape != (COUNT,):
            raise ContractViolation(
                f"{self.name}: expected pixels ({COUNT}, 2) and errors ({COUNT},) of a place, got {self.pixels.shape} and "
                f"{self.error.shape}"
            )
        if self.usable.sum() < PLACES.corners or not (self.error[self.usable] >= 0).all():
            raise ContractViolation(
                f"{self.name}: expected {PLACES.corners} usable corners or more, with their errors, got {self.usable.sum()}"
            )

    @property
    def usable(self) -> np.ndarray:
        """(8,) bool."""
        return np.isfinite(self.pixels).all(axis=1) & np.isfinite(self.error)


def read_rest_poses(
    path: str | Path, calibration: str = "", measured: bool = True, track: KeypointTrack | None = None
) -> list[RestPose]:
    """The places of a rosbag2 recording, none where the object never rests. track: its own, where corners that do not count are known.

    calibration: file of the nominal camera, without which a recording that was made with one is refused; measured: with the
    poses of `object_pose`, where it has them. Raises ContractViolation.
    """
    from np_description.message_arrays import pose_arrays
    from np_record.bag import BagError, Recording  # slow
    from np_record.recorded_episode import read_recorded_task

    name, track = f"bag {path}", track or read_keypoint_track(path)
    try:
        with Recording(path, required=("keypoints",)) as recording:
            domain, used = read_recorded_task(recording), recording.information.get("calibration", "")
            first = recording.rows("keypoints")["keypoints"][0].stamp
            rows = recording.read("object_pose", lambda m: pose_arrays(m, BASE_FRAME)) if measured else ()
            poses = [(stamp, *pose) for stamp, pose in rows]
    except BagError as error:
        raise bag_violation(path, error) from error
    if used and not calibration:
        raise ContractViolation(f"{name}: expected the calibration that it was made with, {used}, got none")
    time = (np.array([stamp for stamp, _, _ in poses], float) - first) / SECOND
    return [_add_measurement(place, rest, track, time, poses) for place, rest in find_rest_poses(track, domain)]


def find_rest_poses(track: KeypointTrack, domain: Task) -> list[tuple[RestPose, slice]]:
    """Places of a track in the order of time, each with its images; rests one after the other at one place are one."""
    groups: list[list[slice]] = []
    for rest in find_rests(track):
        if groups and _distance(_medians(track, groups[-1]), _medians(track, [rest])) < PLACES.same:
            groups[-1].append(rest)
        else:
            groups.append([rest])
    found = []
    for group in groups:
        pixels, error, images = _corners(track, group)
        if np.isfinite(error).sum() >= PLACES.corners:
            begin = track.time[group[0].start]
            name = f"{track.name} from {begin:.1f} s"
            found.append((RestPose(name, pixels, error, domain, images=images), slice(group[0].start, group[-1].stop)))
    return found


def distinct_rest_poses(found: Sequence[RestPose]) -> list[RestPose]:
    """The places, each once: a detector errs in the same way where the same object is seen at the same place again."""
    distinct: list[RestPose] = []
    for place in found:
        same_objects = (p for p in distinct if p.domain.half_size == place.domain.half_size)
        if all(_distance(p.pixels, place.pixels) >= PLACES.same for p in same_objects):
            distinct.append(place)
    return distinct


def _rows(track: KeypointTrack, group: list[slice]) -> np.ndarray:
    """Pixels (n, 8, 2) of the images of some rests, NaN where they are not usable."""
    masked = np.where(track.usable[..., None], track.pixels, np.nan)
    return np.concatenate([masked[rest] for rest in group])


def _medians(track: KeypointTrack, group: list[slice]) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a corner that is never usable has no median
        return np.nanmedian(_rows(track, group), axis=0)


def _distance(one: np.ndarray, other: np.ndarray) -> float:
    """px by which the middle corner lies elsewhere; infinite where none is in both."""
    distances = np.linalg.norm(one - other, axis=1)
    return float(np.nanmedian(distances)) if np.isfinite(distances).any() else np.inf


def _corners(track: KeypointTrack, group: list[slice]) -> tuple[np.ndarray, np.ndarray, int]:
    """Median (8, 2) of each corner, its standard error (8,), NaN for those that are usable too seldom; number of images."""
    rows, middle = _rows(track, group), _medians(track, group)
    counts = np.isfinite(rows[..., 0]).sum(axis=0)
    known = counts >= max(PLACES.images * len(rows), 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        spread = 1.4826 * np.nanmedian(np.abs(rows - middle), axis=(0, 2))  # of a Gaussian, by its median deviation
    # What is remembered from image to image counts less often; a median is sqrt(pi / 2) less sure than a mean.
    count = counts * (1 - PLACES.memory) / (1 + PLACES.memory)
    error = np.sqrt(np.pi / 2) * spread / np.sqrt(np.maximum(count, 1.0))
    return np.where(known[:, None], middle, np.nan), np.where(known, error, np.nan), len(rows)


def _add_measurement(place: RestPose, rest: slice, track: KeypointTrack, time: np.ndarray, poses: list) -> RestPose:
    """The place with the pose measured in the middle of its images; as it is where there is none near."""
    if not poses:
        return place
    images = track.time[rest]
    nearest = int(np.argmin(np.abs(time - images[len(images) // 2])))
    if not images[0] - track.period <= time[nearest] <= images[-1] + track.period:
        return place
    _, position, quaternion = poses[nearest]
    return replace(place, position=position, rotation=matrix_from_quaternion(quaternion))
