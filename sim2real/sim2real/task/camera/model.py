"""Where the corners of a box that lies flat are seen, given what may be wrong with camera, lens, table and box; and the derivatives.

Each place has three numbers of its own, where the box lies on the table and how it is turned. Everything is done for all places at
once. The table is a plane through (.5, 0, height) m, tilted about the base's x and y there; obstacles stand on it. As in
`sim2real.effects`, the camera is moved and turned in axes of the base, and its lens distorts before the focal length acts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from np_common.rotations import matrix_from_vector, vector_from_matrix
from np_description.camera import Camera
from np_description.keypoints import CORNERS
from sim2real.task.camera.parameters import COUNT, parameter_indices
from sim2real.task.camera.rest_poses import RestPose

CENTRE = np.array([0.5, 0.0])  # m, where the table's height is that of its plane
SHIFT, TURN, FOCAL, OFFSET, K1 = (
    parameter_indices(name) for name in ("camera", "camera_turn", "focal", "offset", "k1")
)
HEIGHT, TILT, SIZE = (parameter_indices(name) for name in ("table_height", "table_tilt", "size"))
NEAREST = 0.05  # m before the lens, nearer than which nothing is seen


@dataclass(frozen=True, eq=False)
class CameraScene:
    """k rest poses as arrays."""

    camera: Camera
    """Nominal camera."""
    names: tuple[str, ...]
    """Names of the rest poses."""
    pixels: np.ndarray
    """Corners (k, 8, 2) px, 0 where not usable."""
    usable: np.ndarray
    """Whether (k, 8) a corner is usable."""
    error: np.ndarray
    """Standard errors (k, 8) px."""
    half: np.ndarray
    """Half edges (k, 3) m of the object."""
    face: np.ndarray
    """Rotations (k, 3, 3) from object to table, before yaw."""
    surface: np.ndarray
    """Heights (k,) m of the support over the table."""
    position: np.ndarray
    """Measured positions (k, 3) m."""
    rotation: np.ndarray
    """Measured rotations (k, 3, 3)."""
    measured: np.ndarray
    """Whether (k,) the pose was measured."""

    def __len__(self) -> int:
        return len(self.names)

    def of(self, rows: np.ndarray) -> CameraScene:
        """Some of the places."""
        arrays = {name: value[rows] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return CameraScene(self.camera, tuple(np.array(self.names, object)[rows]), **arrays)


@dataclass(frozen=True, eq=False)
class LinearisedScene:
    """A scene at some numbers, linearised."""

    pixels: np.ndarray
    """Predicted corners (k, 8, 2) px."""
    by_vector: np.ndarray
    """Derivatives (k, 8, 2, d) by the numbers."""
    by_pose: np.ndarray
    """Derivatives (k, 8, 2, 3) by x m, y m, yaw rad of the object."""
    off: np.ndarray
    """Pose minus measured pose (k, 6) in m and rad, 0 where none was measured."""
    off_by_vector: np.ndarray
    """Its derivatives (k, 6, d) by the numbers."""
    off_by_pose: np.ndarray
    """Its derivatives (k, 6, 3) by the pose."""
    ahead: bool
    """Whether every corner is before the lens."""
    by_point: np.ndarray
    """Derivatives (k, 8, 2, 3) px/m by the corner in the object's frame."""


def make_scene(places: Sequence[RestPose], lying: Sequence[tuple[np.ndarray, float]], camera: Camera) -> CameraScene:
    """Of places and how the object lies at each: face (3, 3) and surface m."""
    usable = np.array([p.usable for p in places])
    return CameraScene(
        camera,
        tuple(p.name for p in places),
        np.where(usable[..., None], [p.pixels for p in places], 0.0),
        usable,
        np.where(usable, [p.error for p in places], 1.0),
        np.array([p.domain.half_size for p in places]),
        np.array([face for face, _ in lying]),
        np.array([surface for _, surface in lying]),
        np.array([np.zeros(3) if p.position is None else p.position for p in places]),
        np.array([np.eye(3) if p.rotation is None else p.rotation for p in places]),
        np.array([p.position is not None for p in places]),
    )


def linearise(s: CameraScene, vector: np.ndarray, poses: np.ndarray) -> LinearisedScene:
    """The scene at a vector (d,) and poses (k, 3): x m, y m, yaw rad in the table's plane."""
    k = len(s)
    table, by_tilt = matrix_from_vector(np.array([*vector[TILT], 0.0])), _left(np.array([*vector[TILT], 0.0]))[:, :2]
    cos, sin, zero, one = np.cos(poses[:, 2]), np.sin(poses[:, 2]), np.zeros(k), np.ones(k)
    spin = np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], axis=-1).reshape(k, 3, 3)
    turned = spin @ s.face
    half = s.half + vector[SIZE] / 2
    down = np.abs(s.face[:, 2])  # by half sizes, how high the middle is over the surface
    middle = np.column_stack([poses[:, :2] - CENTRE, s.surface + (down * half).sum(axis=1)])
    arms = np.einsum("kij,kcj->kci", turned, CORNERS * half[:, None])
    on_table = (arms + middle[:, None]) @ table.T
    points = on_table + np.array([*CENTRE, vector[HEIGHT][0]])

    # By the vector, of a point in the base frame: height, tilt, size.
    of_point = np.zeros((k, 8, 3, COUNT))
    of_point[..., 2, HEIGHT[0]] = 1.0
    of_point[..., TILT] = -_cross_matrix(on_table) @ by_tilt
    grown = turned[:, None] * (CORNERS / 2)[:, None, :] + np.array([0.0, 0.0, 1.0])[:, None] * (down / 2)[:, None, None]
    of_point[..., SIZE] = table @ grown
    by_pose = np.zeros((k, 8, 3, 3))
    by_pose[..., 0], by_pose[..., 1] = table[:, 0], table[:, 1]
    by_pose[..., 2] = np.stack([-arms[..., 1], arms[..., 0], np.zeros((k, 8))], axis=-1) @ table.T

    pixels, of_optical, of_lens, ahead = _camera(s.camera, vector, points)
    turn = matrix_from_vector(vector[TURN]) @ np.asarray(s.camera.rotation)
    of_base = of_optical @ turn.T  # (k, 8, 2, 3)
    by_vector = of_base @ of_point + of_lens
    by_vector[..., SHIFT] -= of_base
    ray = points - np.asarray(s.camera.position) - vector[SHIFT]
    by_vector[..., TURN] += of_base @ _cross_matrix(ray) @ _left(vector[TURN])
    own = of_base @ (table @ turned)[:, None]

    # The object itself beside where it was measured.
    off, off_by_vector, off_by_pose = np.zeros((k, 6)), np.zeros((k, 6, COUNT)), np.zeros((k, 6, 3))
    m = s.measured
    if m.any():
        place = middle[m] @ table.T
        off[m, :3] = place + np.array([*CENTRE, vector[HEIGHT][0]]) - s.position[m]
        off[m, 3:] = vector_from_matrix((table @ turned)[m] @ np.swapaxes(s.rotation[m], 1, 2))
        off_by_vector[m, 2, HEIGHT[0]] = 1.0
        off_by_vector[np.ix_(m, range(3), TILT)] = -_cross_matrix(place) @ by_tilt
        off_by_vector[np.ix_(m, range(3), SIZE)] = table[:, 2][:, None] * (down[m] / 2)[:, None, :]
        off_by_vector[np.ix_(m, range(3, 6), TILT)] = by_tilt
        off_by_pose[np.ix_(m, range(3), [0, 1])] = table[:, :2]
        off_by_pose[np.ix_(m, range(3, 6), [2])] = table[:, 2:]
    return LinearisedScene(pixels, by_vector, of_base @ by_pose, off, off_by_vector, off_by_pose, ahead, own)


def _camera(camera: Camera, vector: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    """Of points (k, 8, 3) m in the base frame: pixels (k, 8, 2), their derivatives (k, 8, 2, 3) by the point in the optical frame and
    (k, 8, 2, d) by the lens' numbers, and whether all are before the lens."""
    turn = matrix_from_vector(vector[TURN]) @ np.asarray(camera.rotation)
    optical = (points - np.asarray(camera.position) - vector[SHIFT]) @ turn
    depth = np.maximum(optical[..., 2], NEAREST)
    ideal = optical[..., :2] / depth[..., None]
    square = (ideal**2).sum(axis=-1)
    k1, scale = vector[K1][0], (1 + vector[FOCAL][0]) * np.array([camera.fx, camera.fy])
    bent = ideal * (1 + k1 * square)[..., None]
    pixels = bent * scale + np.array([camera.cx, camera.cy]) + vector[OFFSET]
    of_ideal = np.zeros((*ideal.shape[:2], 2, 3))
    of_ideal[..., 0, 0] = of_ideal[..., 1, 1] = 1 / depth
    of_ideal[..., :, 2] = -ideal / depth[..., None]
    bend = (1 + k1 * square)[..., None, None] * np.eye(2) + 2 * k1 * ideal[..., :, None] * ideal[..., None, :]
    of_lens = np.zeros((*ideal.shape[:2], 2, COUNT))
    of_lens[..., FOCAL[0]] = bent * np.array([camera.fx, camera.fy])
    of_lens[..., OFFSET] = np.eye(2)
    of_lens[..., K1[0]] = scale * ideal * square[..., None]
    return pixels, scale[:, None] * (bend @ of_ideal), of_lens, bool((optical[..., 2] > NEAREST).all())


def _cross_matrix(v: np.ndarray) -> np.ndarray:
    """Matrices (..., 3, 3) that take w to v x w, of vectors (..., 3)."""
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*v.shape, 3)


def _left(vector: np.ndarray) -> np.ndarray:
    """(3, 3): what turn, in the base's axes, a change of a rotation vector (3,) makes (left Jacobian; Chirikjian 2011)."""
    angle = float(np.linalg.norm(vector))
    cross = _cross_matrix(vector)
    if angle < 1e-4:
        return np.eye(3) + cross / 2 + cross @ cross / 6
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * cross @ cross
