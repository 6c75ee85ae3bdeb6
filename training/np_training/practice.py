"""Practice: tasks easier than the domain's own, each a piece of what these take.

On the bump: rolling the cube once to the place next to where it lies, and turning it a little anywhere. Before the wall:
lifting the box part of the way up, and moving it on top. Nothing else is changed: the domain's own tasks are learned in the
same episodes' company, and alone once they succeed (`curriculum.Curriculum.practice`).
"""

from __future__ import annotations

from dataclasses import replace
from math import pi

import torch

from np_description.domains import Domain
from np_description.rotations import matrix_from_quaternion, quaternion_multiply, yaw_quaternion
from np_training.tasks import Poses, draw_apart, from_any, sample_poses, sample_tasks, uniform

ROLLS, LIFTS = 0.6, 0.6  # share of tasks
SQUARE = 0.35  # rad: how far a cube that is to roll is turned from the bump's direction
ASIDE = 0.04  # m: how far a roll or a lift ends to the side of where it begins
LIFT = (0.03, 0.11)  # m


def sample_practice(domain: Domain, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
    """(count,) starts and goals of practice tasks; the domain's own where it has no practice."""
    if domain.start.quarter_turns:
        return draw_apart(_rolls_and_turns, domain, count, generator)
    if domain.tolerance_angle is None:
        return draw_apart(_lifts_and_moves, domain, count, generator)
    return sample_tasks(domain, count, generator)


def _rolls_and_turns(domain: Domain, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
    roll = torch.rand(count, generator=generator, device=generator.device) < ROLLS
    return _choose(roll, _rolls(domain, count, generator), _turns(domain, count, generator))


def _rolls(domain: Domain, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
    """From a region to one beside it, over the edge on which a cube pushed there rolls; yaw changes by up to SQUARE."""
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
    yaw = _yaw_to_square(up)
    turn = torch.zeros(count, 4, device=device)
    turn[:, 0], turn[:, 1] = torch.cos(torch.tensor(pi / 4)), -torch.sin(torch.tensor(pi / 4)) * (target - source)
    square = quaternion_multiply(yaw_quaternion(-yaw), starts.quaternion)
    rolled = quaternion_multiply(yaw_quaternion(yaw + uniform(count, (-SQUARE, SQUARE), generator)),
                                 quaternion_multiply(turn, square))
    return starts, _resting(domain, Poses(goals, rolled), position[target, rows][:, 2], starts.quaternion)


def _yaw_to_square(rotation: torch.Tensor) -> torch.Tensor:
    """Yaw (n,) rad, within an eighth of a turn, of boxes (n, 3, 3) that stand on a face, against the base frame's axes."""
    level = rotation[:, 2].abs().argmin(-1)  # an axis of the object that lies level
    axis = rotation.gather(2, level[:, None, None].expand(-1, 3, 1))[..., 0]
    yaw = torch.atan2(axis[:, 1], axis[:, 0])
    return yaw - torch.round(yaw / (pi / 2)) * (pi / 2)


def _turns(domain: Domain, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
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
    return starts, _resting(domain, Poses(goals.position, turned), goals.position[:, 2], goals.quaternion)


def _resting(domain: Domain, poses: Poses, height: torch.Tensor, before: torch.Tensor) -> Poses:
    """The poses with their centres as high over the surface as their orientation takes, `height` (n,) m being that of
    orientation `before` (n, 4)."""
    half_size = torch.tensor(domain.half_size, device=height.device)
    now, then = ((matrix_from_quaternion(q)[:, 2].abs() * half_size).sum(-1) for q in (poses.quaternion, before))
    position = poses.position.clone()
    position[:, 2] = height + now - then
    return Poses(position, poses.quaternion)


def _lifts_and_moves(domain: Domain, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
    """Up from the start by part of the way, or from a goal to a goal."""
    lift = torch.rand(count, generator=generator, device=generator.device) < LIFTS
    starts = sample_poses(domain, domain.start, count, generator)
    move = torch.stack([torch.zeros(count, device=generator.device), uniform(count, (-ASIDE, ASIDE), generator),
                        uniform(count, LIFT, generator)], -1)
    moves = tuple(from_any(domain, domain.goals, count, generator) for _ in range(2))
    return _choose(lift, (starts, Poses(starts.position + move, starts.quaternion)), moves)


def _choose(where: torch.Tensor, first: tuple[Poses, Poses], second: tuple[Poses, Poses]) -> tuple[Poses, Poses]:
    """Rows of the first tasks where `where` (n,), of the second elsewhere."""
    return tuple(Poses(torch.where(where[:, None], a.position, b.position),
                       torch.where(where[:, None], a.quaternion, b.quaternion)) for a, b in zip(first, second))
