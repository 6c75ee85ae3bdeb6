"""Poses of objects and goals as the policies take them: the pre-contact policy's input, names of faces, corners."""

from __future__ import annotations

import torch

from np_common.rotations import matrix_from_quaternion, quaternion_multiply, six_from_matrix
from np_description.domains import Task
from np_description.keypoints import box_keypoints
from np_description.symmetry import canonical_rotation, symmetries
from np_policy.observation import normalise_keypoints
from np_training.tasks.poses import Poses

PRE_STATE_SIZE = 18


def pre_contact_state(objects: Poses, goals: Poses) -> torch.Tensor:
    """The pre-contact policy's input (n, 18): object and goal, position scaled and 6D rotation."""

    def encode(poses: Poses) -> torch.Tensor:
        centre = torch.tensor([0.5, 0.0, 0.0], device=poses.position.device)
        return torch.cat(
            [(poses.position - centre) / 0.2, six_from_matrix(matrix_from_quaternion(poses.quaternion))], -1
        )

    return torch.cat([encode(objects), encode(goals)], -1)


def canonical_poses(domain: Task, objects: Poses, goals: Poses) -> tuple[Poses, Poses]:
    """Poses of objects and goals (n,) under the names of their faces that the policies see (np_description.symmetry)."""
    if not domain.interchangeable:
        return objects, goals
    turns = torch.tensor(symmetries(domain.half_size), dtype=goals.position.dtype, device=goals.position.device)
    turn = turns[canonical_rotation(domain, normalise_keypoints(corners(domain, goals)))]
    axes = matrix_from_quaternion(turn).abs()  # which of the old edges lies along each of the new axes
    return tuple(
        Poses(
            p.position,
            quaternion_multiply(p.quaternion, turn),
            None if p.scale is None else (p.scale[:, :, None] * axes).sum(1),
        )
        for p in (objects, goals)
    )


def corners(domain: Task, poses: Poses) -> torch.Tensor:
    """Corners (n, 8, 3) m of the domain's object at poses (n,)."""
    return box_keypoints(poses.half_size(domain), poses.position, poses.quaternion)
