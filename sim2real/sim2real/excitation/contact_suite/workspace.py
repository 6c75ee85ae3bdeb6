"""Where the tip and the object may go: clear of obstacles, in the picture, within reach."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from np_common.rotations import matrix_from_quaternion
from np_description.camera import Camera
from np_description.domains import Pose, Task
from np_description.keypoints import CORNERS
from sim2real.excitation.contact_suite.tip import GRIP, HOUSING, RADIUS

CLEAR = 0.008  # m between an object and an obstacle
BESIDE = 0.03  # m between a place of the table that is touched and anything else
EDGE = 1.0  # px from the image's border within which a corner may not be seen any more
FLAT = np.radians(10.0)
"""By which an object that lies flat may be seen tilted: a camera that is turned, or one corner found wrongly, does that."""
SEEN = 6  # corners of the object that have to be in the picture, as a pose takes
REACH = 0.32, 0.72  # m from the arm's first axis, for a hand that points down


@dataclass(frozen=True, eq=False)
class RestingObject:
    """The object as it lies, in the base frame."""

    centre: np.ndarray
    """(3,) m."""
    rotation: np.ndarray
    """(3, 3), object to base."""
    half: np.ndarray
    """(3,) m, half edges."""

    @classmethod
    def of(cls, domain: Task, pose: Pose) -> RestingObject:
        """At a pose."""
        return cls(np.asarray(pose.position), matrix_from_quaternion(pose.quaternion), np.asarray(domain.half_size))

    @property
    def height(self) -> float:
        """m from its lowest to its highest point; of an object that is hardly tilted, its upright edge: it lies flat, and is seen tilted."""
        upright = np.abs(self.rotation[2])
        axis = int(upright.argmax())
        return float(2 * (self.half[axis] if upright[axis] > np.cos(FLAT) else upright @ self.half))

    def sides(self) -> list[tuple[np.ndarray, float]]:
        """Outward normals (2,) of its four upright faces, each with its distance m from the centre."""
        level = [axis for axis in range(3) if abs(self.rotation[2, axis]) < 0.5]
        found = []
        for axis in level:
            normal = self.rotation[:2, axis] / np.linalg.norm(self.rotation[:2, axis])
            found += [(normal, self.half[axis]), (-normal, self.half[axis])]
        return found

    def corners(self, shift: np.ndarray) -> np.ndarray:
        """Corners (8, 3) m, moved by (2,) m."""
        return self.centre + [*shift, 0.0] + (CORNERS * self.half) @ self.rotation.T

    def shift(self, by: np.ndarray) -> RestingObject:
        """The same, by (2,) m elsewhere."""
        return replace(self, centre=self.centre + [*by, 0.0])

    @property
    def reach(self) -> float:
        """m from its centre to its farthest point, seen from above."""
        return float(np.linalg.norm((self.corners(np.zeros(2)) - self.centre)[:, :2], axis=1).max())


@dataclass(frozen=True)
class Workspace:
    """Where the object may go, by a domain and a camera."""

    domain: Task
    """The task's domain."""
    camera: Camera
    """The nominal camera."""

    @property
    def clearance(self) -> float:
        """Height m of the highest obstacle over the table, 0 without any."""
        return max((box.centre[2] + box.half_size[2] for box in self.domain.obstacles), default=0.0)

    def allows(self, resting: RestingObject, shift: np.ndarray) -> bool:
        """Whether the object may be moved by (2,) m: in the workspace, clear of obstacles and in the picture."""
        corners = resting.corners(shift)
        (left, right), (low, high) = self.domain.workspace_x, self.domain.workspace_y
        inside = (corners[:, 0] > left) & (corners[:, 0] < right) & (corners[:, 1] > low) & (corners[:, 1] < high)
        pixels, _ = self.camera.project(corners)
        visible = (pixels > EDGE) & (pixels < np.array([self.camera.width, self.camera.height]) - 1 - EDGE)
        return bool(
            inside.all()
            and visible.all(axis=1).sum() >= SEEN
            and all(_is_clear_of(corners[:, :2], box) for box in self.domain.obstacles)
        )

    def touch_places(self, resting: RestingObject) -> list[np.ndarray]:
        """Four places (2,) m of the bare table, far from one another, at which the tip may touch it. Fewer where there are fewer."""
        (left, right), (low, high) = self.domain.workspace_x, self.domain.workspace_y
        xs, ys = np.linspace(max(left, 0.42), min(right, 0.62), 9), np.linspace(max(low, -0.3), min(high, 0.3), 13)
        forbidden, apart = self._list_forbidden(resting), resting.reach + BESIDE + RADIUS
        free = [
            place
            for place in (np.array([x, y]) for x in xs for y in ys)
            if np.linalg.norm(place - resting.centre[:2]) >= apart
            and is_reachable(place)
            and all(((place < lowest) | (place > highest)).any() for lowest, highest in forbidden)
        ]
        wanted = [np.array([x, y]) for y in (ys[0], ys[-1]) for x in (xs[0], xs[-1])]
        found: list[np.ndarray] = []
        for corner in wanted:
            if free:
                nearest = min(range(len(free)), key=lambda n: float(np.linalg.norm(free[n] - corner)))
                found.append(free.pop(nearest))
        return found

    def _list_forbidden(self, resting: RestingObject) -> list[tuple[np.ndarray, np.ndarray]]:
        """Rectangles, lowest and highest corner (2,) m, in which a hand that points down meets an obstacle or a tall object: by its tip, and
        by its housing, which is as wide as the hand is, along y."""
        tip, housing = BESIDE + RADIUS, HOUSING + BESIDE / 2
        found = [_outline(box, tip) for box in self.domain.obstacles]
        found += [_outline(box, housing) for box in self.domain.obstacles if box.centre[2] + box.half_size[2] > GRIP]
        if resting.height > GRIP:
            corners = resting.corners(np.zeros(2))[:, :2]
            found.append((corners.min(axis=0) - housing, corners.max(axis=0) + housing))
        return found


def is_reachable(place: np.ndarray) -> bool:
    """Whether a hand that points down can be at (2,) m."""
    return REACH[0] < np.linalg.norm(place) < REACH[1]


def _outline(box, margin) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner (2,) m of a box seen from above, grown by a margin, m or (2,) m."""
    centre, half = np.array(box.centre[:2]), np.array(box.half_size[:2])
    return centre - half - margin, centre + half + margin


def _is_clear_of(corners: np.ndarray, box) -> bool:
    """Whether no corner (n, 2) m is over a box, nor beyond its nearest side where it is a wall's length."""
    low, high = _outline(box, CLEAR)
    lowest, highest = corners.min(axis=0), corners.max(axis=0)
    return bool((highest < low).any() or (lowest > high).any())
