"""The action of the pre-contact policy: which point of the gripper meets which point of the object, and how turned.

Nine numbers in [-1, 1]: yaw, two tilts, finger width, two coordinates of a point on the fingertips, and three that pick
a point on the object's surface (paper: gripper orientation, width, gripper point, object point). The pose that follows
puts the gripper's point a small clearance over the object's, so that the approach ends free of contact.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from np_control.kinematics import forward_kinematics, pose_distance, solve_ik
from np_description.domains import Domain
from np_description.panda import FINGER_MAX, NOMINAL
from np_description.rotations import matrix_from_quaternion, matrix_from_vector
from np_description.scene import FINGER_CAPSULES, HAND_CAPSULE
from np_training.tasks import Poses

SIZE = 9
YAW, TILT = 2.0, 0.5  # rad, at an action of 1
CLEARANCE = 0.004  # m
IK_ITERATIONS = 30

_TCP = NOMINAL.frames["hand_tcp"].position
_FINGER_BASE = NOMINAL.frames["hand_finger1"].position
_TIP_CENTRE, _TIP_HALF, _TIP_RADIUS = FINGER_CAPSULES[1]
TIP_DEPTH = _FINGER_BASE[2] + _TIP_CENTRE[2] + _TIP_RADIUS  # m along the hand's z: the lowest point of the fingertips


@dataclass(frozen=True)
class Contacts:
    """Where the hand goes: T_E position (n, 3) m, rotation (n, 3, 3), finger opening width (n,) m, joints q (n, 7) rad,
    and whether a joint solution free of collision exists, feasible (n,)."""

    position: torch.Tensor
    rotation: torch.Tensor
    width: torch.Tensor
    q: torch.Tensor
    feasible: torch.Tensor


def contact_pose(domain: Domain, action: torch.Tensor, objects: Poses) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """T_E position (n, 3) m, rotation (n, 3, 3) and finger width (n,) m that actions (n, 9) choose on the objects."""
    action = action.clamp(-1, 1)
    device = action.device
    zero = torch.zeros_like(action[:, 0])
    yaw = matrix_from_vector(torch.stack([zero, zero, YAW * action[:, 0]], -1))
    down = torch.diag(torch.tensor([1.0, -1.0, -1.0], device=device))
    tilt = matrix_from_vector(torch.stack([TILT * action[:, 1], TILT * action[:, 2], zero], -1))
    rotation = yaw @ down @ tilt
    width = FINGER_MAX * (action[:, 3] + 1) / 2
    gripper_point = torch.stack([_TIP_HALF[0] * action[:, 4], (width + _TIP_CENTRE[1]) * action[:, 5],
                                 torch.full_like(width, TIP_DEPTH - _TCP[2])], -1)
    half_size = torch.tensor(domain.half_size, device=device)
    direction = action[:, 6:] / action[:, 6:].abs().amax(-1, keepdim=True).clamp(min=1e-6)
    normal = torch.where(direction.abs() >= 1 - 1e-6, direction.sign(), torch.zeros_like(direction))
    normal = normal / normal.norm(dim=-1, keepdim=True)
    body = matrix_from_quaternion(objects.quaternion)
    surface = ((direction * half_size + CLEARANCE * normal)[:, None, :] * body).sum(-1) + objects.position
    return surface - (rotation * gripper_point[:, None, :]).sum(-1), rotation, width


def reach(domain: Domain, position: torch.Tensor, rotation: torch.Tensor, width: torch.Tensor, objects: Poses) -> Contacts:
    """Contacts at given hand poses, with a joint solution from the ready posture, and whether it is feasible."""
    ready = torch.tensor(NOMINAL.ready, dtype=position.dtype, device=position.device).expand(len(position), 7)
    q = solve_ik(ready, position, rotation, iterations=IK_ITERATIONS)
    distance, angle = pose_distance(q, position, rotation)
    reached = (distance < 1e-3) & (angle < 1e-2)
    free = gripper_clearance(domain, q, width, objects) > 0
    return Contacts(position, rotation, width, q, reached & free)


def resolve(domain: Domain, action: torch.Tensor, objects: Poses) -> Contacts:
    """The contacts that actions (n, 9) choose on objects at the poses given."""
    return reach(domain, *contact_pose(domain, action, objects), objects)


def gripper_clearance(domain: Domain, q: torch.Tensor, width: torch.Tensor, objects: Poses) -> torch.Tensor:
    """Least distance (n,) m of hand and fingers to table, obstacles and object; negative in collision.

    Capsules are sampled along their axes, which is exact for the table and within 1 mm for boxes of these sizes.
    """
    centres, radii = _gripper_spheres(q, width)
    least = (centres[..., 2] - radii).amin(-1)
    boxes = [(torch.tensor(b.half_size), torch.tensor(b.centre), None) for b in domain.obstacles]
    boxes.append((torch.tensor(domain.half_size), objects.position[:, None], matrix_from_quaternion(objects.quaternion)))
    for half_size, position, turn in boxes:
        local = centres - position.to(centres)
        if turn is not None:
            local = torch.einsum("nij,nki->nkj", turn, local)
        outside = local.abs() - half_size.to(centres)
        distance = outside.clamp(min=0).norm(dim=-1) + outside.amax(-1).clamp(max=0)
        least = torch.minimum(least, (distance - radii).amin(-1))
    return least


def _gripper_spheres(q: torch.Tensor, width: torch.Tensor, samples: int = 9) -> tuple[torch.Tensor, torch.Tensor]:
    """Centres (n, k, 3) m in the base frame and radii (k,) of spheres along the gripper's capsules."""
    tcp, rotation = forward_kinematics(q)
    share = torch.linspace(-1, 1, samples, device=q.device)
    points, radii = [], []
    for side in (0, 1, -1):  # hand, then the two fingers, the second turned half around z
        for centre, half, radius in ((HAND_CAPSULE,) if side == 0 else FINGER_CAPSULES):
            axis = torch.tensor(half, device=q.device) * share[:, None] + torch.tensor(centre, device=q.device)
            local = axis.expand(len(q), samples, 3).clone()
            if side:
                local = local + torch.as_tensor(_FINGER_BASE, dtype=q.dtype, device=q.device)
                local[..., 0] *= side
                local[..., 1] = side * (local[..., 1] + width[:, None])
            points.append(local)
            radii += [radius] * samples
    local = torch.cat(points, 1) - torch.as_tensor(_TCP, dtype=q.dtype, device=q.device)
    centres = torch.einsum("nij,nkj->nki", rotation, local) + tcp[:, None]
    return centres, torch.tensor(radii, device=q.device)
