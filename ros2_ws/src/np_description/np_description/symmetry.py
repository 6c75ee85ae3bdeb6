"""The symmetries of a box: rotations that map it onto itself, and the permutations of its corners.

A cube's task is the same whichever of its faces is called the first, as long as start and goal agree. A policy that
sees the object always under the names that bring its goal nearest to the axes of the base frame learns each task once
instead of 24 times.
"""

from __future__ import annotations

from functools import cache
from itertools import permutations, product

import numpy as np

from np_common.rotations import namespace, quaternion_from_matrix
from np_description.camera import CAMERA
from np_description.domains import Task
from np_description.keypoints import CORNERS, box_keypoints

_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


@cache
def symmetries(half_size: tuple[float, float, float]) -> np.ndarray:
    """Rotations (k, 4) wxyz, the identity first, that lay a box of half_size (3,) m onto itself: 24 for a cube, 8 for a
    square prism, else 4."""
    half, found = np.asarray(half_size), []
    for axes, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.eye(3)[list(axes)] * np.asarray(signs)[:, None]
        if np.linalg.det(matrix) > 0 and np.allclose(np.abs(matrix) @ half, half):
            found.append(matrix)
    found.sort(key=lambda matrix: -np.trace(matrix))
    return quaternion_from_matrix(np.stack(found))


@cache
def corner_orders(half_size: tuple[float, float, float]) -> np.ndarray:
    """Orders (k, 8): the corners of a box at R S are those at R in this order, for each S of `symmetries`."""
    turned = box_keypoints(np.ones(3), np.zeros((len(symmetries(half_size)), 3)), symmetries(half_size))
    return np.linalg.norm(turned[:, :, None] - CORNERS, axis=-1).argmin(axis=-1)


@cache
def _upright(domain: Task) -> np.ndarray:
    """Corners (8, 2) of the object at the identity about their mean, in normalised image coordinates."""
    position = np.array([0.5, 0.0, domain.half_size[2]])
    layout = CAMERA.normalise(CAMERA.project(box_keypoints(np.asarray(domain.half_size), position, _IDENTITY))[0])
    return layout - layout.mean(axis=0)


def canonical_rotation(domain: Task, goal_keypoints):
    """Which of `symmetries` (...,) a policy of the domain sees the object under, for goals at normalised keypoints
    (..., 8, 2), NumPy or PyTorch: the one whose corners lie most as an upright object's do, seen by the nominal camera.
    0, the identity, where the domain's faces are not interchangeable."""
    xp = namespace(goal_keypoints)
    if not domain.interchangeable:
        return xp.zeros_like(goal_keypoints[..., 0, 0], dtype=int if xp is np else xp.long)
    orders, upright = corner_orders(domain.half_size), _upright(domain)
    if xp is not np:
        orders = xp.as_tensor(orders, device=goal_keypoints.device)
        upright = xp.as_tensor(upright, dtype=goal_keypoints.dtype, device=goal_keypoints.device)
    about = goal_keypoints - goal_keypoints.mean(-2)[..., None, :]
    return ((about[..., orders, :] - upright) ** 2).sum(-1).sum(-1).argmin(-1)


def canonicalize_keypoints(domain: Task, keypoints, goal_keypoints):
    """Keypoints (..., 8, k) and goal keypoints (..., 8, k), of which the first two are normalised image coordinates, in the
    order in which a policy of the domain sees them; NumPy or PyTorch."""
    orders, chosen = corner_orders(domain.half_size), canonical_rotation(domain, goal_keypoints[..., :2])
    xp = namespace(keypoints)
    if xp is np:
        order = orders[chosen][..., None]
        return tuple(np.take_along_axis(points, order, axis=-2) for points in (keypoints, goal_keypoints))
    order = xp.as_tensor(orders, device=keypoints.device)[chosen][..., None]
    return tuple(xp.take_along_dim(points, order, dim=-2) for points in (keypoints, goal_keypoints))
