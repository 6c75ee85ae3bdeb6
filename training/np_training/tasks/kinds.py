"""Kinds of task: the domain's own, and the pieces and milder forms of it that practice is made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import pi

import torch

from np_common.rotations import matrix_from_quaternion, quaternion_multiply, yaw_quaternion
from np_description.domains import Task
from np_training.tasks.poses import Poses, from_any, sample_poses, sample_tasks, uniform

SQUARE = 0.35  # rad: how far a cube that is to roll is turned from the bump's direction
ASIDE = 0.04  # m: how far a roll ends to the side of where it begins
NEAR = 0.04  # m: how far from its goal, along x and y, a cube lies at most that has to be turned there
LEFT = 0.2  # rad: how far it has to be turned at least

Draw = Callable[[Task, int, torch.Generator], tuple[Poses, Poses]]


@dataclass(frozen=True)
class Kind:
    """A kind of task."""

    name: str
    """In logs."""
    draw: Draw
    """draw(domain, count, generator): starts and goals (count,)."""
    lowered: tuple[float, float] = (0.0, 0.0)
    """Range of the share of its height by which every obstacle, and what rests on it, is sunk."""
    apart: bool = True
    """Whether tasks closer than the domain's least distance are drawn again."""


OWN = Kind("own", sample_tasks)


def height_at_rest(domain: Task, quaternion: torch.Tensor) -> torch.Tensor:
    """Height (n,) m of the object's centre over what it rests on."""
    half_size = torch.tensor(domain.half_size, device=quaternion.device)
    return (matrix_from_quaternion(quaternion)[:, 2].abs() * half_size).sum(-1)


def lower(name: str, draw: Draw) -> list[Kind]:
    """Kinds from nearly flat to nearly whole."""
    return [Kind(f"{name}{4 - k}", draw, ((k - 1) / 4, k / 4)) for k in (4, 3, 2, 1)]


def slides(
    domain: Task, count: int, generator: torch.Generator, yaw: float, from_start: bool = False
) -> tuple[Poses, Poses]:
    """From any region, or from the domain's start, to any, with the same face up, turned by up to `yaw`."""
    starts = from_any(domain, (domain.start,) if from_start else (domain.start, *domain.goals), count, generator)
    goals = from_any(domain, (domain.start, *domain.goals), count, generator)
    turned = quaternion_multiply(yaw_quaternion(uniform(count, (-yaw, yaw), generator)), starts.quaternion)
    return starts, _resting(domain, Poses(goals.position, turned), goals.quaternion)


def moves(domain: Task, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
    """From a goal to a goal."""
    return tuple(from_any(domain, domain.goals, count, generator) for _ in range(2))


def corrects(domain: Task, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
    """To the domain's own goals, from the places about them: the right face is up already, what is left is a turn about the vertical and some way."""
    goals = from_any(domain, domain.goals, count, generator)
    turn = uniform(count, (-1.0, 1.0), generator)
    turn = turn.sign() * LEFT + (pi - LEFT) * turn
    position = goals.position.clone()
    for axis in range(2):
        position[:, axis] += uniform(count, (-NEAR, NEAR), generator)
    for region in domain.goals:
        inside = (goals.position[:, 1] >= region.y[0]) & (goals.position[:, 1] <= region.y[1])
        position[inside, 0] = position[inside, 0].clamp(*region.x)
        position[inside, 1] = position[inside, 1].clamp(*region.y)
    return Poses(position, quaternion_multiply(yaw_quaternion(turn), goals.quaternion)), goals


def rolls(domain: Task, count: int, generator: torch.Generator, yaw: float) -> tuple[Poses, Poses]:
    """From a region to one beside it, over the edge on which a cube pushed there rolls, and turned by up to `yaw`."""
    device = generator.device
    regions = sorted((domain.start, *domain.goals), key=lambda region: sum(region.y))
    beside = [(i, j) for i in range(len(regions)) for j in (i - 1, i + 1) if 0 <= j < len(regions)]
    pick = torch.randint(0, len(beside), (count,), generator=generator, device=device)
    places = [sample_poses(domain, replace(region, yaw=(-SQUARE, SQUARE)), count, generator) for region in regions]
    rows = torch.arange(count, device=device)
    source, target = (torch.tensor([pair[k] for pair in beside], device=device)[pick] for k in range(2))
    position, quaternion = (torch.stack([getattr(p, name) for p in places]) for name in ("position", "quaternion"))
    starts, goals = Poses(position[source, rows], quaternion[source, rows]), position[target, rows].clone()
    x = regions[0].x
    goals[:, 0] = (starts.position[:, 0] + uniform(count, (-ASIDE, ASIDE), generator)).clamp(*x)
    # Rolling towards +y turns about -x of a cube that stands square; yaw comes first here, so the axis is yawed with it.
    up = matrix_from_quaternion(starts.quaternion)
    square_yaw = _yaw_to_square(up)
    turn = torch.zeros(count, 4, device=device)
    turn[:, 0], turn[:, 1] = torch.cos(torch.tensor(pi / 4)), -torch.sin(torch.tensor(pi / 4)) * (target - source)
    square = quaternion_multiply(yaw_quaternion(-square_yaw), starts.quaternion)
    rolled = quaternion_multiply(
        yaw_quaternion(square_yaw + uniform(count, (-yaw, yaw), generator)), quaternion_multiply(turn, square)
    )
    return starts, _resting(domain, Poses(goals, rolled), quaternion[target, rows])


def _yaw_to_square(rotation: torch.Tensor) -> torch.Tensor:
    """Yaw (n,) rad, within an eighth of a turn, of boxes (n, 3, 3) that stand on a face, against the base frame's axes."""
    level = rotation[:, 2].abs().argmin(-1)  # an axis of the object that lies level
    axis = rotation.gather(2, level[:, None, None].expand(-1, 3, 1))[..., 0]
    yaw = torch.atan2(axis[:, 1], axis[:, 0])
    return yaw - torch.round(yaw / (pi / 2)) * (pi / 2)


def turns(domain: Task, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
    """From any region to any; the goal at most one quarter turn and 45 degrees of yaw from the start."""
    device = generator.device
    starts, goals = (from_any(domain, (domain.start, *domain.goals), count, generator) for _ in range(2))
    axis = torch.randint(1, 4, (count,), generator=generator, device=device)
    half = torch.randint(-1, 2, (count,), generator=generator, device=device) * (pi / 4)
    turn = torch.zeros(count, 4, device=device)
    turn[:, 0] = torch.cos(half)
    turn.scatter_(1, axis[:, None], torch.sin(half)[:, None])
    yaw = yaw_quaternion(uniform(count, (-pi / 4, pi / 4), generator))
    turned = quaternion_multiply(yaw, quaternion_multiply(starts.quaternion, turn))
    return starts, _resting(domain, Poses(goals.position, turned), goals.quaternion)


def _resting(domain: Task, poses: Poses, before: torch.Tensor) -> Poses:
    """The poses, which came with orientation `before` (n, 4), as high over their surfaces as their orientation takes."""
    position = poses.position.clone()
    position[:, 2] += height_at_rest(domain, poses.quaternion) - height_at_rest(domain, before)
    return Poses(position, poses.quaternion)
