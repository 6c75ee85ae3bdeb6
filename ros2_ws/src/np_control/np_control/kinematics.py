"""Kinematics of the Panda: forward kinematics, Jacobian and damped least-squares inverse kinematics.

Batched over leading dimensions and array-generic (NumPy or PyTorch), so that the controller and the GPU environments
resolve a target pose in the same way. Frames: base `panda_link0`; end effector T_E = `panda_tcp`, between the
fingertips, 0.1034 m from the hand's flange (panda_nominal.yaml).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from np_common.rotations import cross, is_one, matrix_from_quaternion, namespace, vector_from_matrix
from np_control.single_configuration import joint_frames, pose_and_jacobian
from np_description.panda import NOMINAL, PandaModel

IK_ITERATIONS = 3
IK_DAMPING = 0.03  # lambda; singular values of the Panda's Jacobian in the workspace are 0.1 to 2


@lru_cache(maxsize=16)
def _constants(panda: PandaModel, dtype, device):
    """Fixed parts of the chain, positions (9, 3) and rotations (9, 3, 3) with hand and tcp last, and joint limits."""
    frames = [*panda.joint_frames, panda.frames["link7_hand"], panda.frames["hand_tcp"]]
    positions = np.stack([frame.position for frame in frames])
    rotations = matrix_from_quaternion(np.stack([frame.quaternion for frame in frames]))
    arrays = positions, rotations, panda.position_lower, panda.position_upper, np.eye(6)
    if device is None:
        return arrays
    import torch

    return tuple(torch.tensor(array, dtype=dtype, device=device) for array in arrays)


def _like(panda: PandaModel, q):
    return _constants(panda, None, None) if namespace(q) is np else _constants(panda, q.dtype, q.device)


def _chain(q, panda: PandaModel):
    """Origins (9 of (..., 3)) and rotations of the seven joint frames after their rotation, then hand, tcp."""
    if is_one(q):
        origins, rotations = joint_frames(q, panda)
        return np.array(origins), np.array(rotations).reshape(9, 3, 3)
    xp = namespace(q)
    offsets, turns, *_ = _like(panda, q)
    position = xp.zeros_like(q[..., :3])
    rotation = turns[0] * xp.ones_like(q[..., :1, None])  # link0 -> link1 has no rotation; broadcast to the batch
    origins, rotations = [], []
    for i in range(9):
        position = position + (rotation @ offsets[i][:, None])[..., 0] if i else position + offsets[0]
        if i:
            rotation = rotation @ turns[i]
        if i < 7:
            c, s = xp.cos(q[..., i, None]), xp.sin(q[..., i, None])
            x, y, z = rotation[..., :, 0], rotation[..., :, 1], rotation[..., :, 2]
            rotation = xp.stack([c * x + s * y, c * y - s * x, z], axis=-1)
        origins.append(position)
        rotations.append(rotation)
    return origins, rotations


def forward_kinematics(q, panda: PandaModel = NOMINAL):
    """Position (..., 3) m and rotation (..., 3, 3) of T_E in the base frame, for joints q (..., 7) rad."""
    origins, rotations = _chain(q, panda)
    return origins[-1], rotations[-1]


def hand_pose(q, panda: PandaModel = NOMINAL):
    """Position (..., 3) m and rotation (..., 3, 3) of the hand frame, for joints q (..., 7) rad."""
    origins, rotations = _chain(q, panda)
    return origins[-2], rotations[-2]


def jacobian(q, panda: PandaModel = NOMINAL):
    """Geometric Jacobian (..., 6, 7) of T_E in the base frame: rows linear m/rad, then angular."""
    return _pose_and_jacobian(q, panda)[2]


def _pose_and_jacobian(q, panda: PandaModel):
    if is_one(q):
        return pose_and_jacobian(q, panda)
    xp = namespace(q)
    origins, rotations = _chain(q, panda)
    axes = [rotation[..., :, 2] for rotation in rotations[:7]]
    linear = [cross(axis, origins[-1] - origin) for axis, origin in zip(axes, origins)]
    matrix = xp.concatenate([xp.stack(linear, axis=-1), xp.stack(axes, axis=-1)], axis=-2)
    return origins[-1], rotations[-1], matrix


def solve_ik(
    q, position, rotation, *, iterations: int = IK_ITERATIONS, damping: float = IK_DAMPING, panda: PandaModel = NOMINAL
):
    """Joints (..., 7) rad near `q` that bring T_E to position (..., 3) m and rotation (..., 3, 3).

    A fixed number of damped least-squares steps, each cut to the joint limits: the result is always finite and within
    limits, and is the nearest compromise where the pose is out of reach. Check with `pose_distance` where it matters.
    """
    xp = namespace(q)
    _, _, lower, upper, identity = _like(panda, q)
    identity = identity * damping**2
    for _ in range(iterations):
        at, turned, matrix = _pose_and_jacobian(q, panda)
        turn = vector_from_matrix(rotation @ matrix_transpose(turned))
        error = xp.concatenate([position - at, turn], axis=-1)
        transposed = matrix_transpose(matrix)
        step = transposed @ _solve(matrix @ transposed + identity, error[..., None])
        q = xp.minimum(xp.maximum(q + step[..., 0], lower), upper)
    return q


def pose_distance(q, position, rotation, panda: PandaModel = NOMINAL):
    """Distance (...) m and angle (...) rad between T_E at q and the pose given."""
    at, turned = forward_kinematics(q, panda)
    turn = vector_from_matrix(rotation @ matrix_transpose(turned))
    return ((position - at) ** 2).sum(axis=-1) ** 0.5, (turn**2).sum(axis=-1) ** 0.5


def matrix_transpose(matrix):
    """Transpose of the last two axes."""
    return namespace(matrix).swapaxes(matrix, -1, -2)


def _solve(a, b):
    xp = namespace(a)
    # solve_ex skips the error check, which would stop the GPU's stream; the damping keeps every system regular.
    return np.linalg.solve(a, b) if xp is np else xp.linalg.solve_ex(a, b)[0]
