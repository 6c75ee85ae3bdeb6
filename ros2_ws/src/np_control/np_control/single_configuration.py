"""The Panda's chain at one configuration, number by number.

Plans of motions evaluate single configurations by the thousand, where the calls of NumPy are the cost and not the numbers. This takes a
quarter of the time of `np_control.kinematics`, which calls it for a single configuration. A test compares the two.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from np_common.rotations import matrix_from_quaternion
from np_description.panda import PandaModel

Numbers = tuple[float, ...]


@lru_cache(maxsize=16)
def _frames(panda: PandaModel) -> tuple[tuple[Numbers, Numbers], ...]:
    """Position (3) m and rotation (9), row by row, of each frame in the one before: seven joints, hand, tcp."""
    frames = [*panda.joint_frames, panda.frames["link7_hand"], panda.frames["hand_tcp"]]
    return tuple(
        (tuple(frame.position.tolist()), tuple(matrix_from_quaternion(frame.quaternion).ravel().tolist()))
        for frame in frames
    )


def joint_frames(q: np.ndarray, panda: PandaModel) -> tuple[list[Numbers], list[Numbers]]:
    """Origins (9 of 3) m and rotations (9 of 9), row by row, of the seven joint frames at joints q (7,) rad, hand and tcp."""
    angles, origins, rotations = q.tolist(), [], []
    px = py = pz = 0.0
    a, b, c, d, e, f, g, h, i = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    for n, ((x, y, z), (r, s, t, u, v, w, k, l, m)) in enumerate(_frames(panda)):  # noqa: E741
        px, py, pz = px + a * x + b * y + c * z, py + d * x + e * y + f * z, pz + g * x + h * y + i * z
        a, b, c = a * r + b * u + c * k, a * s + b * v + c * l, a * t + b * w + c * m
        d, e, f = d * r + e * u + f * k, d * s + e * v + f * l, d * t + e * w + f * m
        g, h, i = g * r + h * u + i * k, g * s + h * v + i * l, g * t + h * w + i * m
        if n < 7:  # turned about its z
            cos, sin = math.cos(angles[n]), math.sin(angles[n])
            a, b = cos * a + sin * b, cos * b - sin * a
            d, e = cos * d + sin * e, cos * e - sin * d
            g, h = cos * g + sin * h, cos * h - sin * g
        origins.append((px, py, pz))
        rotations.append((a, b, c, d, e, f, g, h, i))
    return origins, rotations


def pose_and_jacobian(q: np.ndarray, panda: PandaModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position (3,) m and rotation (3, 3) of T_E at joints q (7,) rad, and its geometric Jacobian (6, 7), linear rows first."""
    origins, rotations = joint_frames(q, panda)
    tx, ty, tz = origins[-1]
    columns = []
    for (px, py, pz), (_, _, x, _, _, y, _, _, z) in zip(origins[:7], rotations):
        dx, dy, dz = tx - px, ty - py, tz - pz
        columns.append((y * dz - z * dy, z * dx - x * dz, x * dy - y * dx, x, y, z))
    jacobian = np.array(list(zip(*columns)))
    return np.array(origins[-1]), np.array(rotations[-1]).reshape(3, 3), jacobian
