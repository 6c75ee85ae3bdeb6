"""The object's pose from its eight keypoints in one image (perspective-n-point with the known box).

At 2 mm a pixel the image of a small flat box fixes its distance only to a centimetre and its tilt to several degrees. Two
tilts may explain the same image. So the pose in which the box rests on a face is tried first: three unknowns instead of six.
Only where a free pose explains the keypoints better, the object is taken to be tilted or in the air.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from np_common.rotations import cross, matrix_from_quaternion, matrix_from_vector, quaternion_from_matrix
from np_description.camera import CAMERA, Camera
from np_description.domains import Box, Pose, Task
from np_description.keypoints import CORNERS, box_keypoints

FARTHEST = 3.0  # m; the camera is about 1 m from the workspace
MIN_POINTS = 6
FLOOR = -0.01  # m, height below which no corner of an object can be; the table's own is known to some millimetres
LIES = 2.0  # px: corners behind the hand are found that far off, side by side, so that a tilt explains them better
TILTED = 0.1  # rad: what rests seems tilted by 0.04 where the camera is turned by 0.028, and by 0.15 where its colours are exchanged
_GOOD = 1.0  # px, error of a fit that needs no second look
_HUBER = 1.5  # px, residual from which a keypoint counts less
_ITERATIONS = 30
_LEAST = 1e-6  # added to a normal matrix, which may be singular


class PoseError(RuntimeError):
    """No pose explains the keypoints; the message gives the reason."""


@dataclass(frozen=True)
class PoseEstimate:
    """An object pose estimated from keypoints."""

    pose: Pose
    """Object in the base frame."""
    rms: float
    """Weighted reprojection error, px."""
    resting: bool
    """Whether the object was taken to lie flat on a surface."""
    position_bound: float
    """Twice the standard deviation of the position, m: by the keypoints' scatter about the fit and the camera's covariance."""
    angle_bound: float
    """Likewise of the orientation, rad."""

    @property
    def tilt(self) -> float:
        """Angle rad by which the face that is nearest to lying flat does not."""
        return float(np.arccos(min(1.0, np.abs(matrix_from_quaternion(self.pose.quaternion)[2]).max())))


def usable_keypoints(keypoints, min_score: float) -> np.ndarray:
    """Which of keypoints (8, 3) u px, v px, score may be used: finite and with at least `min_score`; (8,) bool."""
    keypoints = np.asarray(keypoints, float)
    return np.isfinite(keypoints).all(axis=1) & (keypoints[:, 2] >= min_score)


def has_enough_keypoints(keypoints, min_score: float) -> bool:
    """Whether MIN_POINTS of keypoints (8, 3) or more are usable; None for a message that could not be read."""
    return keypoints is not None and bool(usable_keypoints(keypoints, min_score).sum() >= MIN_POINTS)


def check_resting(keypoints, domain: Task, *, min_score: float = 0.3, camera: Camera = CAMERA) -> None:
    """Raises PoseError where an untouched object rests on none of its faces by its keypoints (8, 3): where only a pose tilted by
    TILTED explains them within LIES. Then it is another object, or has other colours. What no pose explains is left to `estimate_pose`."""
    try:
        found = estimate_pose(keypoints, domain, min_score=min_score, camera=camera, lies=LIES)
    except PoseError:
        return
    if not found.resting and found.tilt > TILTED:
        raise PoseError(
            f"expected the object at rest on a face, got one tilted by {np.degrees(found.tilt):.0f} degrees: "
            "something else, with other colours, or seen by a camera that is not where it is said to be"
        )


def project_keypoints(domain: Task, pose: Pose, camera: Camera = CAMERA) -> np.ndarray:
    """Keypoints (8, 3) u px, v px, score 1 of the object at a pose: goals, for instance.

    Raises ValueError if a corner is not in front of the camera.
    """
    pixels, depth = camera.project(box_keypoints(domain.half_size, pose.position, pose.quaternion))
    if not (np.isfinite(pixels).all() and (depth > 0).all()):
        raise ValueError(f"keypoints: expected a pose in front of the camera, got position {pose.position.tolist()}")
    return np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1)


def estimate_pose(
    keypoints,
    domain: Task,
    *,
    min_score: float = 0.3,
    max_rms: float = 4.0,
    camera: Camera = CAMERA,
    floor: float = -np.inf,
    lies: float = 0.0,
    camera_covariance: np.ndarray | None = None,
) -> PoseEstimate:
    """The object's pose from keypoints (8, 3): u px, v px, score 0..1, in the order of np_description.keypoints.

    min_score: keypoints below it are left out; max_rms px: a worse fit is refused; floor m: no corner is lower, so that of two
    corners that are off by 3 px no card is taken to be 3 cm below the table; lies px: a pose in which it rests on a face is taken
    where it is no worse than that, whatever explains the keypoints better; camera_covariance: of the camera's pose, (6, 6) m and rad as
    in a calibration, None for a camera whose pose is exact. Raises PoseError with fewer than MIN_POINTS usable
    keypoints or without a pose that explains them.
    """
    keypoints = np.asarray(keypoints, float)
    good = usable_keypoints(keypoints, min_score)
    if good.sum() < MIN_POINTS:
        raise PoseError(
            f"expected at least {MIN_POINTS} of 8 keypoints with a score of {min_score:g} or more, got {good.sum()}"
        )
    fit = _Fit(keypoints[good], CORNERS[good] * domain.half_size, camera)
    starts = [
        start
        for height in sorted({0.0, *map(_top, domain.obstacles)})
        for start in fit.resting_starts(height)
        if height == _surface_below(domain, start[0])
    ] or fit.resting_starts(0.0)
    starts = sorted(((*start, fit.rms(*start)) for start in starts), key=_rms)
    near = [start for start in starts[:2] if start[2] <= 2 * starts[0][2] + _GOOD]
    resting = _best(fit.refine(*start[:2], planar=True) for start in near)
    does_lie = resting[2] <= lies
    free = resting if does_lie else fit.refine(*resting[:2], planar=False)
    if not does_lie and (resting[2] > _GOOD or not _explains(resting, free)):  # or both are in a wrong valley
        free = _best([free, *(fit.refine(*start, planar=False) for start in fit.free_starts())])
    lowest = (box_keypoints(domain.half_size, free[0], quaternion_from_matrix(free[1])))[:, 2].min()
    is_resting = _explains(resting, free) or (lowest < floor and resting[2] <= max_rms)
    position, rotation, rms = resting if is_resting else free
    if not rms <= max_rms:
        raise PoseError(f"expected a pose that reprojects within {max_rms:g} px rms, the best is off by {rms:.1f} px")
    far = float(np.linalg.norm(position - camera.position))
    if far > FARTHEST:  # from there any box is a point, and explains eight keypoints in one place
        raise PoseError(f"expected an object within {FARTHEST:g} m of the camera, the best pose is {far:.1f} m from it")
    bounds = fit.bounds(position, rotation, camera_covariance, planar=is_resting)
    return PoseEstimate(Pose(position, quaternion_from_matrix(rotation)), rms, is_resting, *bounds)


def _rms(fit) -> float:
    return fit[2]


def _best(fits):
    return min(fits, key=_rms)


def _top(box: Box) -> float:
    return box.centre[2] + box.half_size[2]


def _surface_below(domain: Task, position) -> float:
    """Height m of what lies under a position: an obstacle's top or the table."""
    return max(
        (
            _top(box)
            for box in domain.obstacles
            if all(abs(position[i] - box.centre[i]) <= box.half_size[i] for i in (0, 1))
        ),
        default=0.0,
    )


def _explains(resting, free) -> bool:
    """Whether the resting fit is as good as the free one, whose three more unknowns always fit a little better.

    Twice as well they fit by chance one time in 500 (F distribution with 3 and 10 degrees of freedom).
    """
    return resting[2] <= max(2 * free[2], free[2] + 0.5)


def _unknowns(planar: bool) -> list[int]:
    """Which of the position's and the rotation vector's six numbers a fit moves: x, y and yaw of what rests, else all."""
    return [0, 1, 5] if planar else list(range(6))


class _Fit:
    """Keypoints (n, 3) and their points (n, 3) m in the object frame."""

    def __init__(self, keypoints, points, camera: Camera) -> None:
        self.pixels, self.scores = np.ascontiguousarray(keypoints[:, :2]), keypoints[:, 2]
        self.points, self.camera = points, camera
        self._view = np.asarray(camera.rotation), np.asarray(camera.position)

    @cached_property
    def _rays(self) -> np.ndarray:
        """Directions (n, 3) of the keypoints in the base frame."""
        flat = (self.pixels - (self.camera.cx, self.camera.cy)) / (self.camera.fx, self.camera.fy)
        return np.concatenate([flat, np.ones((len(flat), 1))], axis=1) @ self._view[0].T

    def resting_starts(self, surface: float) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each face down at a height m, the best position (3,) and rotation (3, 3), in closed form.

        The height of every corner is known then, so its pixel gives its x, y; a planar rigid alignment gives the rest.
        """
        eye, rays = self._view[1], self._rays
        weights = self.scores / self.scores.sum()
        starts = []
        for turn in _FACES_DOWN:
            local = self.points @ turn.T
            z = surface - local[:, 2].min()
            seen = eye[:2] + rays[:, :2] * ((local[:, 2] + z - eye[2]) / rays[:, 2])[:, None]
            centre, middle = weights @ seen, weights @ local[:, :2]
            a, b = local[:, :2] - middle, seen - centre
            yaw = np.arctan2(weights @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), weights @ (a * b).sum(axis=1))
            spin = matrix_from_vector(np.array([0.0, 0.0, yaw]))
            starts.append((np.append(centre - spin[:2, :2] @ middle, z), spin @ turn))
        return starts

    def free_starts(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Position (3,) and rotation (3, 3) by SQPnP (Terzakis and Lourakis, 2020), as a list of none or one."""
        view, eye = self._view
        try:
            found, turn, shift = cv2.solvePnP(
                self.points, self.pixels, self.camera.matrix, None, flags=cv2.SOLVEPNP_SQPNP
            )
        except cv2.error:  # pixels that coincide, or lie on a line
            return []
        if not found or not (np.isfinite(turn).all() and np.isfinite(shift).all()):
            return []
        return [(view @ shift[:, 0] + eye, view @ matrix_from_vector(turn[:, 0]))]

    def refine(self, position, rotation, *, planar: bool) -> tuple[np.ndarray, np.ndarray, float]:
        """Gauss-Newton on Huber-weighted reprojection errors: position (3,), rotation (3, 3), rms px.

        planar: only x, y and yaw move. (scipy.optimize.least_squares finds the same poses in 10.6 ms an image, this in
        4.3 ms of CPU time; its Huber loss is of each coordinate, while a wrong keypoint is off in both.)
        """
        free = _unknowns(planar)
        least = _LEAST * np.eye(len(free))
        for _ in range(_ITERATIONS):
            residual, matrix = self._linearise(position, rotation)
            matrix = matrix[:, free]
            weights = np.repeat(self._weights(residual), 2)
            normal = matrix.T @ (weights[:, None] * matrix) + least
            step = np.zeros(6)
            step[free] = np.linalg.solve(normal, matrix.T @ (weights * residual.ravel()))
            position, rotation = position + step[:3], matrix_from_vector(step[3:]) @ rotation
            if np.abs(step).max() < 1e-5:  # m, rad
                break
        return position, rotation, self.rms(position, rotation)

    def bounds(self, position, rotation, camera_covariance: np.ndarray | None, *, planar: bool) -> tuple[float, float]:
        """Twice the standard deviations of a refined pose, m and rad; what is not free is taken to be known."""
        free = _unknowns(planar)
        residual, jacobian = self._linearise(position, rotation)
        weights = np.repeat(self._weights(residual), 2)
        weighted = jacobian[:, free].T * weights
        inverse = np.linalg.inv(weighted @ jacobian[:, free] + _LEAST * np.eye(len(free)))
        # The scatter is itself an estimate: Student's t has (n / (n - 2)) times the variance.
        covariance = inverse * (weights @ residual.ravel() ** 2 / (len(weights) - len(free) - 2))
        if camera_covariance is not None:
            # A camera moved by p and turned by r sees the object moved by -p - r x arm and turned by -r.
            arm = position - self._view[1]
            seen = -np.eye(6)
            seen[:3, 3:] = cross(arm, np.eye(3)).T
            gain = inverse @ weighted @ jacobian @ seen
            covariance = covariance + gain @ camera_covariance @ gain.T
        variances = np.diag(covariance)
        shift = np.array(free) < 3
        return float(2 * np.sqrt(variances[shift].sum())), float(2 * np.sqrt(variances[~shift].sum()))

    def rms(self, position, rotation) -> float:
        """Huber-weighted root mean square reprojection error px; infinite where there is none."""
        residual = self._residual(*self._is_seen(self.points @ rotation.T, position))
        weights = self._weights(residual)
        rms = float(np.sqrt(weights @ (residual**2).sum(axis=1) / weights.sum()))
        return rms if np.isfinite(rms) else np.inf

    def _weights(self, residual) -> np.ndarray:
        distance = np.linalg.norm(residual, axis=1)
        return self.scores * np.minimum(1.0, _HUBER / np.maximum(distance, 1e-9))

    def _linearise(self, position, rotation) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (n, 2) px, measured minus predicted, and the Jacobian (2n, 6) of the prediction."""
        arms = self.points @ rotation.T
        x, y, z = self._is_seen(arms, position)
        of_optical = np.zeros((len(z), 2, 3))
        of_optical[:, 0, 0], of_optical[:, 0, 2] = self.camera.fx / z, -self.camera.fx * x / z**2
        of_optical[:, 1, 1], of_optical[:, 1, 2] = self.camera.fy / z, -self.camera.fy * y / z**2
        matrix = np.empty((len(z), 2, 6))
        of_point = np.matmul(of_optical, self._view[0].T, out=matrix[..., :3])
        # A turn w of the object moves a corner by w x arm = -[arm]x w.
        matrix[..., 3:] = cross(arms[:, None, :], of_point)
        return self._residual(x, y, z), matrix.reshape(-1, 6)

    def _is_seen(self, arms, position) -> np.ndarray:
        """Places (3, n) m, in the camera's frame, of points (n, 3) m about a position."""
        view, eye = self._view
        seen = ((arms + position - eye) @ view).T
        seen[2, np.abs(seen[2]) < 1e-3] = 1e-3
        return seen

    def _residual(self, x, y, z) -> np.ndarray:
        predicted = np.empty_like(self.pixels)
        predicted[:, 0] = self.camera.fx * x / z + self.camera.cx
        predicted[:, 1] = self.camera.fy * y / z + self.camera.cy
        return self.pixels - predicted


_FACES_DOWN = [
    matrix_from_vector(np.array(vector) * np.pi / 2)
    for vector in ((0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0), (0, 1, 0), (0, 3, 0))
]
"""Rotations (3, 3) that put each face of the box down."""
