"""What is seen and felt while an experiment runs: where the object is, how low the tip came, and whether the hand presses too hard."""

from __future__ import annotations

from collections import deque

import numpy as np

from np_control.dynamics import Dynamics
from np_control.kinematics import forward_kinematics
from np_control.safety import tip_force
from np_description.camera import CAMERA, Camera
from np_description.domains import Task
from np_perception.pose_estimation import MIN_POINTS, PoseError, estimate_pose, usable_keypoints
from sim2real.excitation.contact_suite.suite import SuiteState
from sim2real.excitation.contact_suite.tip import lowest_corner

IMAGES = 8  # of which the median is taken
SCORE = 0.3  # of a corner that counts
HARDEST = 90.0
"""N, at which an experiment is broken off: the last resort. Our controller presses with 30 N at most (`np_control.safety.press`), and a tap that
brakes reads as 50."""
SLOW = 0.1  # rad/s, of the fastest joint of an arm that presses


class OutOfPicture(ValueError):
    """An object that has left the picture, or is hidden: nothing further can be planned; what was recorded counts."""


class SuiteMonitor:
    """Takes keypoints and states in the order of their stamps. camera: the nominal one."""

    def __init__(self, domain: Task, camera: Camera = CAMERA):
        self._domain, self._camera = domain, camera
        self._images: deque[tuple[int, np.ndarray]] = deque(maxlen=IMAGES)
        self._dynamics = Dynamics()
        self._lowest: float | None = None

    def add_keypoints(self, stamp: int, keypoints: np.ndarray) -> None:
        """Keypoints (8, 3) u px, v px, score of an image of `stamp` ns. One that was sent again changes nothing."""
        if not self._images or stamp > self._images[-1][0]:
            self._images.append((stamp, keypoints))

    def has_image(self, since: int) -> bool:
        """Whether an image of `since` ns or later has come."""
        return bool(self._images) and self._images[-1][0] >= since

    def check_contact(self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> str:
        """Position (7,) rad, velocity (7,) rad/s and torque (7,) Nm without gravity of a state; what is wrong, "" for nothing."""
        position, rotation = forward_kinematics(q)
        height = float(lowest_corner(position[None], rotation[None])[0, 2])
        self._lowest = height if self._lowest is None else min(self._lowest, height)
        if np.abs(dq).max() >= SLOW:  # only what presses counts: on its way a fast arm takes forces of its own
            return ""
        size = float(np.linalg.norm(tip_force(q, torque - self._dynamics.coriolis(q, dq))))
        return f"the hand presses with {size:.0f} N; up to {HARDEST:g} are allowed" if size > HARDEST else ""

    def state(self, q: np.ndarray) -> SuiteState:
        """Of an arm that rests at joints (7,) rad; the tip's lowest height is counted anew from here. Raises OutOfPicture where
        too few corners are seen, ValueError where no pose explains them."""
        rows = np.array([keypoints for _, keypoints in self._images])
        good = np.array([usable_keypoints(keypoints, SCORE) for keypoints in rows])
        visible = good.mean(axis=0) > 0.5
        if visible.sum() < MIN_POINTS:
            raise OutOfPicture(f"{visible.sum()} of 8 corners are seen; {MIN_POINTS} are needed")
        masked = np.where(good[..., None], rows[..., :2], np.nan)
        corners = np.zeros((len(visible), 2))
        corners[visible] = np.nanmedian(masked[:, visible], axis=0)
        try:
            pose = estimate_pose(
                np.column_stack([corners, visible.astype(float)]), self._domain, camera=self._camera
            ).pose
        except PoseError as error:
            raise ValueError(str(error)) from error
        state, self._lowest = SuiteState(q, pose, self._lowest), None
        return state
