"""The sealed test's camera: rows that are read one after another, an exposure, a lens, stamps that jitter, a hand in the way.

It shares no code with the diagnosis, or with the effects by which the diagnosis predicts a picture: poses are turned by SciPy, projected by OpenCV, and
gaps of the view are read from a patch by their names. A stamp is of the middle of the exposure of the picture's middle row, as a RealSense's
sensor timestamp is, and `camera_latency` is what it is late beyond that.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from sim2real.effects.patch import Patch

from np_blind.camera.hand_in_view import hidden
from np_blind.camera.quirks import Quirks
from np_blind.camera.simulated_detector import SimulatedDetector
from np_common.rotations import xyzw_from_wxyz
from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA
from np_description.domains import Pose

NS = 1e-9  # s
MOMENTS = 7  # of an exposure, whose pictures are averaged
ROUNDS = 3  # in which a corner's row and its moment are found
KEPT = 1.0  # s of poses, more than any latency
LONGEST = 0.033  # s of an exposure at 30 Hz
SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)  # of a box's corners, (8, 3)


@dataclass(frozen=True)
class UnknownCameraFaults:
    """What no catalogue has: knocked rad to the side, from `at` s on; breathing: share by which the picture grows and shrinks; hunting s: period of
    an exposure that hunts, and dark: how many times noisier corners are in its darkest images."""

    knocked: float = 0.0
    at: float = 0.0
    breathing: float = 0.0
    hunting: float = 0.0
    dark: float = 1.0


BREATH = 7.0  # s, in which a lens that hunts goes out of focus and back


class DistortedCamera:
    """A camera before which a box of `half` (3,) m is moved. gap: effects of the view among others; seed: of all chance."""

    def __init__(
        self,
        half: np.ndarray,
        quirks: Quirks,
        gap: Patch,
        seed: int,
        strange: UnknownCameraFaults = UnknownCameraFaults(),
    ):
        self._half, self._quirks, self._strange = np.asarray(half), quirks, strange
        self._rng = np.random.default_rng([seed, 7])
        moved = _sums(gap, "camera_extrinsics")
        turn = Rotation.from_rotvec([moved.get(f"turn_{axis}", 0.0) for axis in "xyz"])
        self.eye = np.array(CAMERA.position) + [moved.get(axis, 0.0) for axis in "xyz"]
        inwards = (turn * Rotation.from_matrix(CAMERA.rotation)).inv()
        self._turn, self._shift = inwards.as_rotvec(), -inwards.apply(self.eye)
        self._late = _sums(gap, "camera_latency").get("delay", 0.0)
        self._finding = SimulatedDetector(quirks, _sums(gap, "keypoint_noise"), _sums(gap, "keypoint_outliers"), seed)
        self._poses: deque[tuple[float, Pose, np.ndarray]] = deque()
        self._due: deque[int] = deque()
        self._stamp = -1

    def look(self, stamp: int, pose: Pose, q: np.ndarray, is_due: bool) -> list[tuple[int, np.ndarray]]:
        """Of the state at `stamp` ns, later than any before: the object's pose, joints (7,) rad, and whether an image is to have that
        stamp. What is ready by now, each with its stamp ns: u px, v px, score (8, 3)."""
        now = stamp * NS
        self._poses.append((now, pose, q))
        while self._poses[0][0] < now - KEPT:
            self._poses.popleft()
        if is_due:
            self._due.append(stamp)
        ready = []
        while self._due and self._due[0] * NS - self._late + (self._quirks.rows + LONGEST) / 2 <= now:
            ready.append(self._image(self._due.popleft()))
        return ready

    def _image(self, stamp: int) -> tuple[int, np.ndarray]:
        moment = stamp * NS - self._late
        around = self._quirks.rows + LONGEST
        poses = list(self._poses)
        first = max(bisect_left(poses, moment - around, key=_time) - 1, 0)
        poses = poses[first : bisect_left(poses, moment + around, key=_time) + 1]
        times = np.array([time for time, _, _ in poses])
        corners = self._corners([pose for _, pose, _ in poses])
        exposure = self._exposure(moment)
        spread = exposure * ((np.arange(MOMENTS) + 0.5) / MOMENTS - 0.5)
        middle, rows = (CAMERA.height - 1) / 2, np.full(8, (CAMERA.height - 1) / 2)
        for _ in range(ROUNDS):
            at = (moment + self._quirks.rows * (rows - middle) / CAMERA.height)[:, None] + spread
            shown = self._project(_between(times, corners, at), moment)
            pixels = shown.mean(axis=1)
            rows = pixels[:, 1]
        nearest = min(int(np.searchsorted(times, moment)), len(times) - 1)
        covered = hidden(self.eye, corners[nearest], *forward_kinematics(poses[nearest][2]))
        darkness = max(0.0, self._hunt(moment))
        noisier = 1.0 + (self._strange.dark - 1.0) * darkness
        found = self._finding(pixels, shown[:, -1] - shown[:, 0], covered, noisier, darkness)
        late = self._quirks.jitter * (self._rng.standard_exponential() - 1.0)
        self._stamp = max(stamp + round(late / NS), self._stamp + 1_000_000)
        return self._stamp, found

    def _corners(self, poses: list[Pose]) -> np.ndarray:
        """Corners (n, 8, 3) m of the box at poses."""
        turns = Rotation.from_quat(xyzw_from_wxyz(np.array([pose.quaternion for pose in poses]))).as_matrix()
        return (SIGNS * self._half) @ turns.transpose(0, 2, 1) + np.array([pose.position for pose in poses])[:, None]

    def _hunt(self, moment: float) -> float:
        return float(np.sin(2 * np.pi * moment / self._strange.hunting)) if self._strange.hunting else 0.0

    def _exposure(self, moment: float) -> float:
        """s: of an exposure that hunts, up to three times as long in the dark, and as short in the light."""
        return min(self._quirks.exposure * 3.0 ** self._hunt(moment), LONGEST)

    def _project(self, points: np.ndarray, moment: float) -> np.ndarray:
        """Pixels (8, m, 2) of points (8, m, 3) m."""
        import cv2  # slow, and a command's --help reaches this module

        seen, _ = cv2.projectPoints(
            points.reshape(-1, 1, 3), self._turn, self._shift, CAMERA.matrix, np.array(self._quirks.lens)
        )
        seen, middle = seen.reshape(*points.shape[:2], 2), np.array([CAMERA.cx, CAMERA.cy])
        swing = self._strange.breathing * np.sin(2 * np.pi * moment / BREATH)
        aside = CAMERA.fx * np.tan(self._strange.knocked) * (moment > self._strange.at)
        return seen + swing * (seen - middle) + [aside, 0.0]


def _time(kept: tuple[float, Pose, np.ndarray]) -> float:
    return kept[0]


def _between(times: np.ndarray, corners: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Corners (8, m, 3) m, each at its own moments (8, m) s, of corners (n, 8, 3) m at times (n,) s."""
    if len(times) == 1:
        return np.repeat(corners[0][:, None], at.shape[1], axis=1)
    k = np.clip(np.searchsorted(times, at) - 1, 0, len(times) - 2)
    share = np.clip((at - times[k]) / (times[k + 1] - times[k]), 0.0, 1.0)[..., None]
    which = np.arange(8)[:, None]
    return (1 - share) * corners[k, which] + share * corners[k + 1, which]


def _sums(gap: Patch, effect: str) -> dict[str, float]:
    """Parameters of an effect in a patch, added up."""
    found: dict[str, float] = {}
    for one in gap.of(effect):
        for name, value in one.parameters.items():
            found[name] = found.get(name, 0.0) + value
    return found
