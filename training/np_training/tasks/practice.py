"""Practice: tasks easier than the domain's own among these, each a piece or a milder form of what they take.

The task's file (card, bump, wall) defines the kinds. How often each is drawn follows from how well it succeeds
(`curriculum.Curriculum.shares`), so that their grades are climbed as fast as they are learned. A lowered obstacle is the same
one, sunk into the table; goals on it sink with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from np_common.rotations import matrix_from_quaternion
from np_description.domains import Task
from np_training.tasks.kinds import Kind, height_at_rest
from np_training.tasks.poses import Poses, draw_distant, edges, uniform
from np_training.tasks.registry import find_task


@dataclass(frozen=True)
class Tasks:
    """Tasks (n,)."""

    starts: Poses
    """Where the objects begin."""
    goals: Poses
    """Where they are to end."""
    kind: torch.Tensor
    """Index into the task's kinds (n,)."""
    sunk: torch.Tensor
    """How deep the obstacles are, m (n,)."""


def draw_tasks(
    domain: Task,
    shares: tuple[float, ...],
    count: int,
    generator: torch.Generator,
    size: tuple[float, float] = (1.0, 1.0),
) -> Tasks:
    """(count,) tasks in random order, of which each of the kinds of the domain's task has its share; size: range of the factor that each
    of the object's edges has."""
    ends = [round(sum(shares[: k + 1]) * count) for k in range(len(shares) - 1)]
    parts = [
        _draw_kind(domain, number, kind, end - begin, generator)
        for number, (kind, begin, end) in enumerate(zip(find_task(domain.name).kinds, (0, *ends), (*ends, count)))
    ]
    order = torch.randperm(count, generator=generator, device=generator.device)

    def joined(values: list[torch.Tensor]) -> torch.Tensor:
        return torch.cat(values)[order]

    starts, goals = (
        Poses(joined([p.position for p in poses]), joined([p.quaternion for p in poses]))
        for poses in ([p.starts for p in parts], [p.goals for p in parts])
    )
    if size != (1.0, 1.0):
        scale = edges(count, size, generator)
        starts, goals = (scale_poses(domain, poses, scale) for poses in (starts, goals))
    return Tasks(starts, goals, joined([p.kind for p in parts]), joined([p.sunk for p in parts]))


def _draw_kind(domain: Task, number: int, kind: Kind, count: int, generator: torch.Generator) -> Tasks:
    if kind.apart:
        starts, goals = draw_distant(kind.draw, domain, count, generator)
    else:
        starts, goals = kind.draw(domain, count, generator)
    share = uniform(count, kind.lowered, generator)
    top = max((box.centre[2] + box.half_size[2] for box in domain.obstacles), default=0.0)
    starts, goals = (_lowered(domain, poses, share) for poses in (starts, goals))
    return Tasks(starts, goals, torch.full((count,), number, device=generator.device), top * share)


def _lowered(domain: Task, poses: Poses, share: torch.Tensor) -> Poses:
    """The poses with the surfaces that they rest on lowered by a share (n,) of their height."""
    surface = poses.position[:, 2] - height_at_rest(domain, poses.quaternion)
    position = poses.position.clone()
    position[:, 2] -= share * surface
    return Poses(position, poses.quaternion)


def scale_poses(domain: Task, poses: Poses, scale: torch.Tensor) -> Poses:
    """Where objects with edges `scale` (n, 3) times as long are in place of those at the poses: on the same surface, and beside an obstacle with the
    same gap to it."""
    longer = (scale - 1) * torch.tensor(domain.half_size).to(scale)
    more = (matrix_from_quaternion(poses.quaternion).abs() * longer[:, None]).sum(-1)  # along x, y, z
    position = poses.position.clone()
    position[:, 2] += more[:, 2]
    for box in domain.obstacles:
        away = poses.position[:, :2] - torch.tensor(box.centre[:2]).to(scale)
        beside = away.abs() > torch.tensor(box.half_size[:2]).to(scale)
        position[:, :2] += beside * away.sign() * more[:, :2]
    return Poses(position, poses.quaternion, scale)
