"""Rotations of batches: quaternions, matrices, rotation vectors, the 6D form.

Every function takes NumPy arrays or PyTorch tensors of any leading shape and returns the same kind. So training
(tensors on a GPU) and the nodes (arrays) share one definition. Quaternions are scalar first (w, x, y, z), as in MuJoCo;
ROS puts the scalar last, and `wxyz_from_xyzw` / `xyzw_from_wxyz` are the only place where the order changes.
"""

from __future__ import annotations

from math import sqrt

import numpy as np


def namespace(array):
    """The array library of `array`: torch for tensors, NumPy for anything else."""
    if type(array).__module__.split(".")[0] == "torch":
        import torch

        return torch
    return np


def is_one(array) -> bool:
    """Whether it is a single row of doubles, whose numbers are dealt with in a tenth of the time as such, with the same result."""
    return isinstance(array, np.ndarray) and array.ndim == 1 and array.dtype == np.float64


def wxyz_from_xyzw(quaternion):
    """Scalar-first order (..., 4) from ROS's scalar-last order."""
    return namespace(quaternion).concatenate([quaternion[..., 3:], quaternion[..., :3]], axis=-1)


def xyzw_from_wxyz(quaternion):
    """ROS's scalar-last order (..., 4) from scalar-first order."""
    return namespace(quaternion).concatenate([quaternion[..., 1:], quaternion[..., :1]], axis=-1)


def quaternion_multiply(a, b):
    """Hamilton product a * b of (..., 4) quaternions: rotate by b, then by a."""
    xp = namespace(a)
    aw, ax, ay, az = (a[..., i] for i in range(4))
    bw, bx, by, bz = (b[..., i] for i in range(4))
    return xp.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def quaternion_conjugate(quaternion):
    """Inverse of unit quaternions (..., 4)."""
    return namespace(quaternion).concatenate([quaternion[..., :1], -quaternion[..., 1:]], axis=-1)


def matrix_from_quaternion(quaternion):
    """Rotation matrices (..., 3, 3) of quaternions (..., 4), which are normalised first."""
    xp = namespace(quaternion)
    unit = quaternion / xp.sqrt((quaternion * quaternion).sum(axis=-1, keepdims=True))
    w, x, y, z = unit.tolist() if is_one(unit) else (unit[..., i] for i in range(4))
    rows = [
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    ]
    if is_one(unit):
        return np.array(rows).reshape(3, 3)
    return xp.stack(rows, axis=-1).reshape(quaternion.shape[:-1] + (3, 3))


def quaternion_from_matrix(matrix):
    """Unit quaternions (..., 4), w >= 0, of rotation matrices (..., 3, 3).

    Uses the outer product 4 q q^T, whose column with the largest diagonal is well conditioned for every rotation.
    """
    xp = namespace(matrix)
    one_matrix = matrix.ndim == 2 and is_one(matrix[0])
    m = matrix.tolist() if one_matrix else [[matrix[..., i, j] for j in range(3)] for i in range(3)]
    one = 1.0 if one_matrix else xp.ones_like(m[0][0])
    outer = [
        one + m[0][0] + m[1][1] + m[2][2],
        m[2][1] - m[1][2],
        m[0][2] - m[2][0],
        m[1][0] - m[0][1],
        m[2][1] - m[1][2],
        one + m[0][0] - m[1][1] - m[2][2],
        m[0][1] + m[1][0],
        m[0][2] + m[2][0],
        m[0][2] - m[2][0],
        m[0][1] + m[1][0],
        one - m[0][0] + m[1][1] - m[2][2],
        m[1][2] + m[2][1],
        m[1][0] - m[0][1],
        m[0][2] + m[2][0],
        m[1][2] + m[2][1],
        one - m[0][0] - m[1][1] + m[2][2],
    ]
    if one_matrix:
        largest = max(range(4), key=outer[::5].__getitem__)
        w, x, y, z = outer[largest::4]
        norm = sqrt(w * w + x * x + y * y + z * z)
        norm = -norm if w < 0 else norm
        return np.array([w / norm, x / norm, y / norm, z / norm])
    outer = xp.stack(outer, axis=-1).reshape(matrix.shape[:-2] + (4, 4))
    diagonal = xp.stack([outer[..., i, i] for i in range(4)], axis=-1)
    largest = diagonal.argmax(axis=-1)
    if xp is np:
        column = np.take_along_axis(outer, largest[..., None, None], axis=-1)[..., 0]
    else:
        column = xp.take_along_dim(outer, largest[..., None, None], dim=-1)[..., 0]
    unit = column / xp.sqrt((column * column).sum(axis=-1, keepdims=True))
    return xp.where(unit[..., :1] < 0, -unit, unit)


def matrix_from_vector(vector):
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), axis times angle in rad (Rodrigues)."""
    if is_one(vector):
        x, y, z = vector.tolist()
        angle = sqrt(x * x + y * y + z * z)
        half_sinc = 0.5 if angle < 1e-6 else np.sin(angle / 2) / angle
        return matrix_from_quaternion(np.array([np.cos(angle / 2), x * half_sinc, y * half_sinc, z * half_sinc]))
    xp = namespace(vector)
    angle = xp.sqrt((vector * vector).sum(axis=-1))
    small = angle < 1e-6
    safe = xp.where(small, xp.ones_like(angle), angle)
    half_sinc = xp.where(small, xp.full_like(angle, 0.5), xp.sin(safe / 2) / safe)
    w = xp.cos(angle / 2)
    quaternion = xp.concatenate([w[..., None], vector * half_sinc[..., None]], axis=-1)
    return matrix_from_quaternion(quaternion)


def vector_from_matrix(matrix):
    """Rotation vectors (..., 3), angle in [0, pi], of rotation matrices (..., 3, 3)."""
    xp = namespace(matrix)
    quaternion = quaternion_from_matrix(matrix)
    if is_one(quaternion):
        w, x, y, z = quaternion.tolist()
        norm = sqrt(x * x + y * y + z * z)
        return quaternion[1:] * (2.0 if norm < 1e-7 else 2 * float(np.arctan2(norm, w)) / norm)
    imaginary = quaternion[..., 1:]
    norm = xp.sqrt((imaginary * imaginary).sum(axis=-1))
    angle = 2 * xp.arctan2(norm, quaternion[..., 0])
    small = norm < 1e-7
    scale = xp.where(small, xp.full_like(norm, 2.0), angle / xp.where(small, xp.ones_like(norm), norm))
    return imaginary * scale[..., None]


def rotation_angle(a, b):
    """Geodesic angle in rad, shape (...), between quaternions (..., 4); the sign of a quaternion does not matter."""
    xp = namespace(a)
    relative = quaternion_multiply(quaternion_conjugate(a), b)
    norm = xp.sqrt((relative[..., 1:] * relative[..., 1:]).sum(axis=-1))
    return 2 * xp.arctan2(norm, xp.abs(relative[..., 0]))


def six_from_matrix(matrix):
    """The 6D form (..., 6): the first two columns of (..., 3, 3) (Zhou et al., CVPR 2019)."""
    return namespace(matrix).concatenate([matrix[..., :, 0], matrix[..., :, 1]], axis=-1)


def matrix_from_six(six):
    """Rotation matrices (..., 3, 3) from the 6D form by Gram-Schmidt (Zhou et al., CVPR 2019)."""
    xp = namespace(six)
    a, b = six[..., :3], six[..., 3:]
    x = a / xp.sqrt((a * a).sum(axis=-1, keepdims=True))
    b = b - (x * b).sum(axis=-1, keepdims=True) * x
    y = b / xp.sqrt((b * b).sum(axis=-1, keepdims=True))
    return xp.stack([x, y, cross(x, y)], axis=-1)


def cross(a, b):
    """Cross product of (..., 3) vectors."""
    if is_one(a) and is_one(b):
        (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
        return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
    xp = namespace(a)
    return xp.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )


def yaw_quaternion(yaw):
    """Quaternions (..., 4) of rotations by `yaw` rad about +z."""
    xp = namespace(yaw)
    zero = xp.zeros_like(yaw)
    return xp.stack([xp.cos(yaw / 2), zero, zero, xp.sin(yaw / 2)], axis=-1)
