"""Practice: kinds of task easier than the domain's own, each a piece or a milder form of what these take.

On the bump, each in grades of yaw: rolling the cube once to the place next to where it lies; sliding it where there is hardly
a bump; sliding it across one that is lower than it is; and one quarter turn about any axis, without the bump and with it.
Before the wall: moving the box on top, and bringing it up while the wall is lower. A lowered obstacle is the same one, sunk
into the table; goals on it sink with it. How often each kind is drawn follows from how well it succeeds
(`curriculum.Curriculum.shares`), so that the grades are climbed as fast as they are learned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import pi

import torch

from np_description.domains import Domain, Region
from np_description.rotations import matrix_from_quaternion, quaternion_multiply, yaw_quaternion
from np_training.tasks.poses import Poses, draw_apart, from_any, sample_poses, sample_tasks, uniform

SQUARE = 0.35  # rad: how far a cube that is to roll is turned from the bump's direction
YAWS = (0.35, pi / 2, pi)  # rad: grades of how far a cube is turned about the vertical at most
FLAT = (0.75, 1.0)  # share of the obstacles' height that is sunk where they are hardly felt
ASIDE = 0.04  # m: how far a roll ends to the side of where it begins

Draw = Callable[[Domain, int, torch.Generator], tuple[Poses, Poses]]


@dataclass(frozen=True)
class Kind:
    """draw(domain, count, generator): starts and goals (count,); lowered: range of the share of its height by which every
    obstacle, and what rests on it, is sunk."""

    name: str
    draw: Draw
    lowered: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Tasks:
    """starts, goals (n,); kind (n,): index into `kinds(domain)`; sunk (n,) m: how deep the obstacles are."""

    starts: Poses
    goals: Poses
    kind: torch.Tensor
    sunk: torch.Tensor


def kinds(domain: Domain) -> tuple[Kind, ...]:
    """The kinds of task of a domain: its own first, then its practice, if any."""
    own = Kind("own", sample_tasks)
    if domain.start.quarter_turns:
        anywhere = (domain.start, *domain.goals)
        graded = [
            kind
            for grade, yaw in enumerate(YAWS, 1)
            for kind in (
                Kind(f"roll{grade}", partial(_rolls, yaw=yaw)),
                Kind(f"slide{grade}", partial(_slides, regions=anywhere, yaw=yaw), FLAT),
                Kind(f"cross{grade}", partial(_slides, regions=(domain.start,), yaw=yaw), (0.0, FLAT[0])),
            )
        ]
        return own, *graded, Kind("turn1", _turns, FLAT), Kind("turn2", _turns)
    if domain.obstacles:
        return own, Kind("top", _moves), *_lower("low", sample_tasks)
    return (own,)


def draw_tasks(domain: Domain, shares: tuple[float, ...], count: int, generator: torch.Generator) -> Tasks:
    """(count,) tasks in random order, of which each of `kinds(domain)` has its share."""
    ends = [round(sum(shares[: k + 1]) * count) for k in range(len(shares) - 1)]
    parts = [
        _draw_kind(domain, number, kind, end - begin, generator)
        for number, (kind, begin, end) in enumerate(zip(kinds(domain), (0, *ends), (*ends, count)))
    ]
    order = torch.randperm(count, generator=generator, device=generator.device)

    def joined(values: list[torch.Tensor]) -> torch.Tensor:
        return torch.cat(values)[order]

    starts, goals = (
        Poses(joined([p.position for p in poses]), joined([p.quaternion for p in poses]))
        for poses in ([p.starts for p in parts], [p.goals for p in parts])
    )
    return Tasks(starts, goals, joined([p.kind for p in parts]), joined([p.sunk for p in parts]))


def _draw_kind(domain: Domain, number: int, kind: Kind, count: int, generator: torch.Generator) -> Tasks:
    starts, goals = draw_apart(kind.draw, domain, count, generator)
    share = uniform(count, kind.lowered, generator)
    top = max((box.centre[2] + box.half_size[2] for box in domain.obstacles), default=0.0)
    starts, goals = (_lowered(domain, poses, share) for poses in (starts, goals))
    return Tasks(starts, goals, torch.full((count,), number, device=generator.device), top * share)


def _lowered(domain: Domain, poses: Poses, share: torch.Tensor) -> Poses:
    """The poses with the surfaces that they rest on lowered by a share (n,) of their height."""
    surface = poses.position[:, 2] - _extent(domain, poses.quaternion)
    position = poses.position.clone()
    position[:, 2] -= share * surface
    return Poses(position, poses.quaternion)


def _extent(domain: Domain, quaternion: torch.Tensor) -> torch.Tensor:
    """Height (n,) m of the object's centre over what it rests on."""
    half_size = torch.tensor(domain.half_size, device=quaternion.device)
    return (matrix_from_quaternion(quaternion)[:, 2].abs() * half_size).sum(-1)


def _lower(name: str, draw: Draw) -> list[Kind]:
    """Kinds from nearly flat to nearly whole."""
    return [Kind(f"{name}{4 - k}", draw, ((k - 1) / 4, k / 4)) for k in (4, 3, 2, 1)]


def _slides(
    domain: Domain, count: int, generator: torch.Generator, regions: tuple[Region, ...], yaw: float
) -> tuple[Poses, Poses]:
    """From one of `regions` to any, with the same face up, turned by up to `yaw`."""
    starts = from_any(domain, regions, count, generator)
    goals = from_any(domain, (domain.start, *domain.goals), count, generator)
    turned = quaternion_multiply(yaw_quaternion(uniform(count, (-yaw, yaw), generator)), starts.quaternion)
    return starts, _resting(domain, Poses(goals.position, turned), goals.quaternion)


def _moves(domain: Domain, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
    """From a goal to a goal."""
    return tuple(from_any(domain, domain.goals, count, generator) for _ in range(2))


def _rolls(domain: Domain, count: int, generator: torch.Generator, yaw: float) -> tuple[Poses, Poses]:
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
    return starts, _resting(domain, Poses(goals.position, turned), goals.quaternion)


def _resting(domain: Domain, poses: Poses, before: torch.Tensor) -> Poses:
    """The poses, which came with orientation `before` (n, 4), as high over their surfaces as their orientation takes."""
    position = poses.position.clone()
    position[:, 2] += _extent(domain, poses.quaternion) - _extent(domain, before)
    return Poses(position, poses.quaternion)
