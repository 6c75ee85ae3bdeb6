"""States in which the object is in the camera's view: what the policies' episodes pass through, and a little beyond.

The object lies anywhere in the workspace, now and then tilted or lifted. The hand touches it where the
pre-contact policy may choose to, slides or hovers beside and over it, is on its way from the ready posture,
or waits there: occlusion by hand and fingers is the normal case.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import pi

import torch
from torch.nn import functional

from np_common.rotations import (
    matrix_from_quaternion,
    matrix_from_vector,
    quaternion_from_matrix,
    quaternion_multiply,
    yaw_quaternion,
)
from np_control.kinematics import solve_ik
from np_description.domains import Task
from np_description.panda import FINGER_MAX, NOMINAL
from np_training.environment import contact
from np_training.tasks.poses import Poses, sample_tasks, uniform

STATE_SIZE = 16


@dataclass(frozen=True)
class SceneConfig:
    """Shares of the states, and their spread.

    touching, beside, under_way: shares of the hand on the object, beside or over it, between there and the
    ready posture (the rest waits at the ready posture); spread: share of objects drawn from the whole
    workspace and `margin` m beyond, where no obstacle is in the way; tilted: share of tilted and lifted
    objects, by `tilt` rad and `lift` m; absent: share of images without the object; closed: share of closed
    fingers; upper: share of contacts on the object's upper face (the others may be on any); joint_noise rad:
    of an arm that is on its way or waits.
    """

    touching: float = 0.45
    beside: float = 0.30
    under_way: float = 0.15
    spread: float = 0.7
    margin: float = 0.02
    tilted: float = 0.15
    tilt: float = 0.25
    lift: float = 0.03
    absent: float = 0.03
    closed: float = 0.6
    upper: float = 0.7
    joint_noise: float = 0.08


def sample_states(domain: Task, count: int, generator: torch.Generator, config: SceneConfig = SceneConfig()):
    """Joint positions (count, 16) of the scene: 7 joints, 2 fingers, object position, object quaternion
    wxyz."""
    objects = sample_objects(domain, count, generator, config)

    def chance(share: float) -> torch.Tensor:
        return torch.rand(count, generator=generator, device=generator.device) < share

    contacts = sample_contacts(domain, objects, generator, config)
    kind = torch.rand(count, generator=generator, device=generator.device)
    beside = (kind >= config.touching) & (kind < config.touching + config.beside)
    waits = kind >= config.touching + config.beside
    under_way = waits & (kind < config.touching + config.beside + config.under_way)

    low = chance(0.5)
    offset = 0.05 * torch.randn(count, 3, generator=generator, device=generator.device)
    offset[:, 2] = torch.where(low, uniform(count, (-0.004, 0.01), generator), uniform(count, (0.0, 0.2), generator))
    moved = solve_ik(contacts.q, contacts.position + offset, contacts.rotation, iterations=10)

    ready = torch.tensor(NOMINAL.ready, dtype=contacts.q.dtype, device=contacts.q.device)
    share = torch.where(under_way, uniform(count, (0.0, 1.0), generator), torch.zeros_like(kind))[:, None]
    noise = config.joint_noise * torch.randn(count, 7, generator=generator, device=generator.device)
    free = ready + share * (contacts.q - ready) + noise
    q = torch.where(waits[:, None], free, torch.where(beside[:, None], moved, contacts.q))

    # The fingers of a position servo under load differ a little.
    fingers = contacts.width[:, None] + 5e-4 * torch.randn(count, 2, generator=generator, device=generator.device)
    position = objects.position.clone()
    position[:, 2] = torch.where(chance(config.absent), -torch.ones_like(kind), position[:, 2])
    return torch.cat([q, fingers.clamp(0, FINGER_MAX), position, objects.quaternion], dim=-1)


def sample_contacts(domain: Task, objects: Poses, generator: torch.Generator, config: SceneConfig):
    """A contact of the pre-contact policy's kind on each object, feasible if one of five random ones
    is."""
    count = len(objects.position)
    up = matrix_from_quaternion(objects.quaternion)[:, 2]  # in the object's frame
    face = functional.one_hot(up.abs().argmax(dim=1), 3) * up.sign()
    best = None
    for _ in range(5):
        action = 2 * torch.rand(count, contact.SIZE, generator=generator, device=generator.device) - 1
        closed = torch.rand(count, generator=generator, device=generator.device) < config.closed
        action[:, 3] = torch.where(closed, -torch.ones_like(action[:, 3]), action[:, 3])
        upper = torch.rand(count, 1, generator=generator, device=generator.device) < config.upper
        action[:, 6:] = torch.where(upper & (face != 0), face, action[:, 6:])
        new = contact.resolve(domain, action, objects)
        if best is None:
            best = new
            continue
        keep = best.feasible
        best = contact.Contacts(
            *(
                torch.where(keep.view(-1, *[1] * (old.ndim - 1)), old, fresh)
                for old, fresh in ((getattr(best, f.name), getattr(new, f.name)) for f in fields(contact.Contacts))
            )
        )
    return best


def sample_objects(domain: Task, count: int, generator: torch.Generator, config: SceneConfig) -> Poses:
    """Object poses: starts and goals of tasks, or anywhere in the workspace, some tilted and lifted."""
    starts, goals = sample_tasks(domain, count, generator)
    coin = torch.rand(3, count, generator=generator, device=generator.device)
    first = (coin[0] < 0.5)[:, None]
    position = torch.where(first, starts.position, goals.position)
    quaternion = torch.where(first, starts.quaternion, goals.quaternion)
    if not domain.obstacles:
        (x0, x1), (y0, y1), m = domain.workspace_x, domain.workspace_y, config.margin
        anywhere = torch.stack(
            [
                uniform(count, (x0 - m, x1 + m), generator),
                uniform(count, (y0 - m, y1 + m), generator),
                position[:, 2],
            ],
            dim=-1,
        )
        spread = (coin[1] < config.spread)[:, None]
        position = torch.where(spread, anywhere, position)
        turned = quaternion_multiply(yaw_quaternion(uniform(count, (-pi, pi), generator)), quaternion)
        quaternion = torch.where(spread, turned, quaternion)
    tilted = (coin[2] < config.tilted)[:, None].to(position.dtype)
    vector = tilted * config.tilt * torch.randn(count, 3, generator=generator, device=generator.device)
    quaternion = quaternion_multiply(quaternion_from_matrix(matrix_from_vector(vector)), quaternion)
    radius = sum(side**2 for side in domain.half_size) ** 0.5
    lift = vector.norm(dim=-1).clamp(max=1) * radius + tilted[:, 0] * uniform(count, (0.0, config.lift), generator)
    position = position + torch.stack([torch.zeros_like(lift), torch.zeros_like(lift), lift], dim=-1)
    return Poses(position, quaternion)


def tumble_objects(domain: Task, states: torch.Tensor, share: float, generator: torch.Generator) -> torch.Tensor:
    """`states` (n, 16), in a share of which the object lies on any of its faces, at any yaw, as low as it was.

    In its tasks an object lies in one way on top of an obstacle, and so it does in episodes that go well; where it has tipped otherwise a
    detector that was not trained on this pose finds nothing.
    """
    count = len(states)
    quarters = torch.randint(0, 4, (2, count), generator=generator, device=generator.device) * (pi / 2)
    zero = torch.zeros_like(quarters[0])
    about_x, about_y = (
        quaternion_from_matrix(matrix_from_vector(torch.stack(vector, -1)))
        for vector in ((quarters[0], zero, zero), (zero, quarters[1], zero))
    )
    yaw = yaw_quaternion(uniform(count, (-pi, pi), generator))
    quaternion = quaternion_multiply(yaw, quaternion_multiply(about_x, about_y)).to(states.dtype)
    half = torch.tensor(domain.half_size, dtype=states.dtype, device=states.device)
    reach = [(matrix_from_quaternion(q)[:, 2].abs() * half).sum(-1) for q in (states[:, 12:16], quaternion)]
    laid = states.clone()
    laid[:, 11] += reach[1] - reach[0]
    laid[:, 12:16] = quaternion
    taken = torch.rand(count, 1, generator=generator, device=generator.device) < share
    return torch.where(taken, laid, states)
