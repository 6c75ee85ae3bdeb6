"""The action of the pre-contact policy: which point of the gripper meets which point of the object, and how turned.

Nine numbers in [-1, 1]: yaw, two tilts, finger width, two coordinates of a point on the fingertips, and a direction, in
the base frame, from the object's centre to the point of its surface (paper: gripper orientation, width, gripper point,
object point). The gripper's point comes over the object's, and the hand is moved out along the face's normal until the
fingers keep a small clearance from it, so that the approach ends free of contact. Orientation counts from one that suits the face: hand down over an upper face; before a side face, turned
so that both fingers face it and leaning over, away from the object.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import pi

import numpy as np
import torch

from np_common.rotations import matrix_from_quaternion, matrix_from_vector
from np_control.kinematics import pose_distance
from np_description.domains import Task
from np_description.hand import BoxShape, CapsuleShape, HandShapes, Shape
from np_description.panda import NOMINAL
from np_planning.stand_off import CLEARANCE, retreat
from np_training.physics.batched_kinematics import forward_kinematics, solve_ik
from np_training.tasks.poses import Poses

SIZE = 9
YAW, TILT = 2.0, 0.5  # rad, at an action of 1, over an upper face
SIDE_YAW, LEAN, SIDE_TILT = 0.4, (0.2, 1.0), 0.4  # rad, before a side face; LEAN: from the vertical, away from the face
YAW_CENTRE = pi / 4  # rad, yaw with the last joint in the middle of its range
IK_ITERATIONS = 30

_TCP = NOMINAL.frames["hand_tcp"].position
_FINGER_BASE = NOMINAL.frames["hand_finger1"].position
SAMPLES = 9  # of a shape along its longest side


@dataclass(frozen=True)
class Contacts:
    """Where the hand goes."""

    position: torch.Tensor
    """Of T_E, m (n, 3)."""
    rotation: torch.Tensor
    """Of T_E (n, 3, 3)."""
    width: torch.Tensor
    """Opening of a finger, m (n,)."""
    q: torch.Tensor
    """Joints, rad (n, 7)."""
    feasible: torch.Tensor
    """Whether a joint solution free of collision exists (n,)."""


def contact_pose(
    domain: Task, action: torch.Tensor, objects: Poses, hand: HandShapes | None = None
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """T_E position (n, 3) m, rotation (n, 3, 3) and finger width (n,) m, up to what the domain allows, that actions
    (n, 9) choose on the objects."""
    hand = hand or domain.contact.hand
    tip = hand.tip
    action = action.clamp(-1, 1)
    point, normal = surface_point(domain, action[:, 6:], objects)
    rotation = hand_rotation(action[:, :3], normal)
    width = domain.max_opening * (action[:, 3] + 1) / 2
    gripper_point = torch.stack(
        [
            hand.tip_width * action[:, 4],
            (width + tip.centre[1]) * action[:, 5],
            torch.full_like(width, _FINGER_BASE[2] + tip.centre[2] - _TCP[2]),
        ],
        -1,
    )
    position = point - (rotation * gripper_point[:, None, :]).sum(-1)
    centres, radii = gripper_spheres(position, rotation, width, hand, with_housing=False)
    depth = (radii - ((centres - point[:, None]) * normal[:, None]).sum(-1)).amax(-1)  # of the fingers below the face
    return position + (depth + CLEARANCE)[:, None] * normal, rotation, width


def surface_point(domain: Task, direction: torch.Tensor, objects: Poses) -> tuple[torch.Tensor, torch.Tensor]:
    """Where rays from the objects' centres along `direction` (n, 3), base frame, leave them (n, 3) m; the normal of the
    face there (n, 3)."""
    body = matrix_from_quaternion(objects.quaternion)
    # A box is scaled to a cube, so that each of its faces has the same odds, however thin it is.
    local = (direction[:, :, None] * body).sum(1)
    face = local.abs().argmax(-1, keepdim=True)
    local = local / local.gather(1, face).abs().clamp(min=1e-6)
    normal = torch.zeros_like(local).scatter(1, face, local.gather(1, face).sign())
    point = ((local * objects.half_size(domain))[:, None, :] * body).sum(-1) + objects.position
    return point, (normal[:, None, :] * body).sum(-1)


def hand_rotation(action: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
    """Rotation of T_E (n, 3, 3) for yaw and tilts (n, 3) in [-1, 1] at faces with normals (n, 3), base frame."""
    zero = torch.zeros_like(normal[:, 0])
    side = normal[:, :2].norm(dim=-1) > 0.5
    heading = torch.atan2(normal[:, 1], normal[:, 0])
    # The hand has two ways to face a plane, half a turn apart: the one that is nearer to the middle of the wrist's range.
    turns = torch.round((heading - YAW_CENTRE) / pi)
    forward = 1 - 2 * (turns.remainder(2))  # whether the hand's x axis points along the normal, or against it
    yaw = torch.where(side, heading - turns * pi + SIDE_YAW * action[:, 0], YAW * action[:, 0])
    lean = -forward * (LEAN[0] + (LEAN[1] - LEAN[0]) * (action[:, 2] + 1) / 2)
    about_x = torch.where(side, SIDE_TILT * action[:, 1], TILT * action[:, 1])
    about_y = torch.where(side, lean, TILT * action[:, 2])
    down = torch.diag(torch.tensor([1.0, -1.0, -1.0], device=action.device))
    return (
        matrix_from_vector(torch.stack([zero, zero, yaw], -1))
        @ down
        @ matrix_from_vector(torch.stack([about_x, about_y, zero], -1))
    )


def reach(
    domain: Task,
    position: torch.Tensor,
    rotation: torch.Tensor,
    width: torch.Tensor,
    objects: Poses,
    sunk: torch.Tensor | float = 0.0,
    hand: HandShapes | None = None,
) -> Contacts:
    """Contacts at given hand poses, with a joint solution from the ready posture, and whether it is feasible. sunk (n,) m:
    how deep the obstacles are."""
    ready = torch.tensor(NOMINAL.ready, dtype=position.dtype, device=position.device).expand(len(position), 7)
    q = solve_ik(ready, position, rotation, iterations=IK_ITERATIONS)
    distance, angle = pose_distance(q, position, rotation)
    reached = (distance < 1e-3) & (angle < 1e-2)
    free = gripper_clearance(domain, q, width, objects, sunk, hand) > 0
    return Contacts(position, rotation, width, q, reached & free)


def resolve(
    domain: Task,
    action: torch.Tensor,
    objects: Poses,
    sunk: torch.Tensor | float = 0.0,
    hand: HandShapes | None = None,
) -> Contacts:
    """The contacts that actions (n, 9) choose on objects at the poses given, with obstacles sunk (n,) m."""
    return reach(domain, *contact_pose(domain, action, objects, hand), objects, sunk, hand)


def gripper_clearance(
    domain: Task,
    q: torch.Tensor,
    width: torch.Tensor,
    objects: Poses,
    sunk: torch.Tensor | float = 0.0,
    hand: HandShapes | None = None,
) -> torch.Tensor:
    """Least distance (n,) m of hand and fingers to table, obstacles sunk (n,) m, and object; negative in collision.

    Shapes are filled with spheres and their edges lined with points, which is exact for the table and within some 2 mm for
    boxes of these sizes.
    """
    centres, radii = gripper_spheres(*forward_kinematics(q), width, hand or domain.contact.hand)
    least = (centres[..., 2] - radii).amin(-1)
    down = torch.zeros(len(q), 1, 3).to(centres)
    down[:, 0, 2] = sunk
    for box in domain.obstacles:
        centre = torch.tensor(box.centre).to(centres) - down
        least = torch.minimum(least, _box_clearance(centres, radii, torch.tensor(box.half_size), centre))
    return torch.minimum(least, _object_clearance(domain, centres, radii, objects))


def draw_out(
    domain: Task,
    position: torch.Tensor,
    rotation: torch.Tensor,
    width: torch.Tensor,
    objects: Poses,
    hand: HandShapes | None = None,
) -> torch.Tensor:
    """T_E positions (n, 3) m of hands that a student placed, by the approach's rule (`np_planning.stand_off.retreat`): those that touch the
    object go out along the face's normal to where episodes begin."""
    spheres = gripper_spheres(position, rotation, width, hand or domain.contact.hand)
    inside = _object_clearance(domain, *spheres, objects) < 0
    out = retreat(domain, objects.position, objects.quaternion, position, rotation, width, objects.half_size(domain))
    return torch.where(inside[:, None], position + out, position)


def _object_clearance(domain: Task, centres: torch.Tensor, radii: torch.Tensor, objects: Poses) -> torch.Tensor:
    turn = matrix_from_quaternion(objects.quaternion)
    return _box_clearance(centres, radii, objects.half_size(domain), objects.position[:, None], turn)


def _box_clearance(
    centres: torch.Tensor,
    radii: torch.Tensor,
    half_size: torch.Tensor,
    position: torch.Tensor,
    turn: torch.Tensor | None = None,
) -> torch.Tensor:
    """Least distance (n,) m of spheres at centres (n, k, 3) m with radii (k,) to boxes at position, turned by turn (n, 3, 3)."""
    local = centres - position.to(centres)
    if turn is not None:
        local = torch.einsum("nij,nki->nkj", turn, local)
    outside = local.abs() - half_size.to(centres).reshape(-1, 1, 3)
    distance = outside.clamp(min=0).norm(dim=-1) + outside.amax(-1).clamp(max=0)
    return (distance - radii).amin(-1)


def gripper_spheres(
    tcp: torch.Tensor,
    rotation: torch.Tensor,
    width: torch.Tensor,
    hand: HandShapes,
    with_housing: bool = True,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Centres (n, k, 3) m in the base frame and radii (k,) of spheres that fill the gripper's shapes, and of points along
    their edges, for T_E at tcp (n, 3) m, rotation (n, 3, 3), and finger openings width (n,) m."""
    options = dict(dtype=tcp.dtype, device=tcp.device)
    points, radii = [], []
    if with_housing:
        centres, size = _filling(hand.housing)
        points.append(torch.as_tensor(centres, **options).expand(len(tcp), -1, 3))
        radii.append(size)
    centres, size = _filling(hand.finger)
    for side in (1, -1):  # the second finger: half a turn about z
        local = (torch.as_tensor(centres, **options) + torch.as_tensor(_FINGER_BASE, **options)).repeat(len(tcp), 1, 1)
        local[..., 0] *= side
        local[..., 1] = side * (local[..., 1] + width[:, None])
        points.append(local)
        radii.append(size)
    local = torch.cat(points, 1) - torch.as_tensor(_TCP, **options)
    centres = torch.einsum("nij,nkj->nki", rotation, local) + tcp[:, None]
    return centres, torch.as_tensor(np.concatenate(radii), dtype=torch.float32, device=tcp.device)


@cache
def _filling(shapes: tuple[Shape, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Centres (k, 3) m in the body's frame and radii (k,) m of the spheres for some shapes."""
    parts = [_filled_box(shape) if isinstance(shape, BoxShape) else _filled_capsule(shape) for shape in shapes]
    return tuple(np.concatenate(column) for column in zip(*parts))


def _filled_capsule(shape: CapsuleShape) -> tuple[np.ndarray, np.ndarray]:
    along = np.linspace(-1, 1, SAMPLES)[:, None] * np.asarray(shape.half_axis)
    return along + np.asarray(shape.centre), np.full(SAMPLES, shape.radius)


def _filled_box(shape: BoxShape) -> tuple[np.ndarray, np.ndarray]:
    """Spheres as wide as the box's shortest side, and points on its twelve edges."""
    half = np.asarray(shape.half_size)
    radius = half.min()

    def spread(extent: float) -> np.ndarray:
        count = 1 if extent == 0 else min(SAMPLES, 1 + int(np.ceil(2 * extent / radius)))
        return np.linspace(-extent, extent, count) if count > 1 else np.zeros(1)

    inner = np.stack(np.meshgrid(*(spread(extent) for extent in half - radius), indexing="ij"), -1).reshape(-1, 3)
    edges = []
    for axis in range(3):
        ends = [spread(half[axis]) if k == axis else np.array([-half[k], half[k]]) for k in range(3)]
        edges.append(np.stack(np.meshgrid(*ends, indexing="ij"), -1).reshape(-1, 3))
    lines = np.unique(np.concatenate(edges), axis=0)
    centres = np.concatenate([inner, lines]) + np.asarray(shape.centre)
    return centres, np.concatenate([np.full(len(inner), radius), np.zeros(len(lines))])
