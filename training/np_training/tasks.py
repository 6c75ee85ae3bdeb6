"""Start and goal poses of a domain in batches: the regions of np_description.domains, drawn with PyTorch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import torch

from np_description.domains import Domain, Region
from np_description.rotations import matrix_from_quaternion, quaternion_multiply, yaw_quaternion


@dataclass(frozen=True)
class Poses:
    """position (n, 3) m and quaternion wxyz (n, 4), base frame."""

    position: torch.Tensor
    quaternion: torch.Tensor

    def __getitem__(self, index) -> Poses:
        return Poses(self.position[index], self.quaternion[index])


def uniform(count: int, bounds: tuple[float, float], generator: torch.Generator) -> torch.Tensor:
    """(count,) numbers, uniform in bounds, on the generator's device."""
    low, high = bounds
    return low + (high - low) * torch.rand(count, generator=generator, device=generator.device)


def sample_poses(domain: Domain, region: Region, count: int, generator: torch.Generator) -> Poses:
    """(count,) poses at rest in a region."""
    quaternion = yaw_quaternion(uniform(count, region.yaw, generator))
    if region.quarter_turns:
        for axis in (2, 1):  # pitch, then roll, in the rotated frame: yaw * pitch * roll
            half = torch.randint(0, 4, (count,), generator=generator, device=generator.device) * (pi / 4)
            turn = torch.zeros(count, 4, device=generator.device)
            turn[:, 0], turn[:, axis] = torch.cos(half), torch.sin(half)
            quaternion = quaternion_multiply(quaternion, turn)
    half_size = torch.tensor(domain.half_size, device=generator.device)
    height = region.surface + (matrix_from_quaternion(quaternion)[:, 2].abs() * half_size).sum(-1)
    position = torch.stack([uniform(count, region.x, generator), uniform(count, region.y, generator), height], dim=-1)
    return Poses(position, quaternion)


def sample_tasks(domain: Domain, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
    """(count,) starts and goals of the domain; tasks closer than its least distance are drawn again."""
    return _apart(_draw, domain, count, generator)


def sample_practice(domain: Domain, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
    """(count,) starts and goals, easier than the domain's: from any of its regions to any, the goal turned by at most one
    quarter turn and 45 degrees of yaw from the start."""
    return _apart(_draw_practice, domain, count, generator)


def quarter_tips(starts: Poses, goals: Poses) -> torch.Tensor:
    """How many quarter turns (n,), 0 to 2, bring the face that points up at the goal up from where it is at the start."""
    up = (matrix_from_quaternion(starts.quaternion)[:, 2] * matrix_from_quaternion(goals.quaternion)[:, 2]).sum(-1)
    return torch.round(torch.acos(up.clamp(-1, 1)) / (pi / 2)).long()


def _apart(draw: Callable[..., tuple[Poses, Poses]], domain: Domain, count: int,
           generator: torch.Generator) -> tuple[Poses, Poses]:
    starts, goals = draw(domain, count, generator)
    while True:
        near = (starts.position - goals.position).norm(dim=-1) < domain.min_distance
        again = int(near.sum())
        if not again:
            return starts, goals
        new_starts, new_goals = draw(domain, again, generator)
        for old, new in ((starts, new_starts), (goals, new_goals)):
            old.position[near], old.quaternion[near] = new.position, new.quaternion


def _draw(domain: Domain, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
    starts = sample_poses(domain, domain.start, count, generator)
    goals = _from_any(domain, domain.goals, count, generator)
    if domain.goal_yaw is not None:
        turn = yaw_quaternion(uniform(count, domain.goal_yaw, generator))
        goals = Poses(goals.position, quaternion_multiply(turn, starts.quaternion))
    return starts, goals


def _draw_practice(domain: Domain, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
    regions = (domain.start, *domain.goals)
    starts, goals = (_from_any(domain, regions, count, generator) for _ in range(2))
    return starts, _turned_little(domain, starts, goals, generator) if domain.start.quarter_turns else goals


def _from_any(domain: Domain, regions: tuple[Region, ...], count: int, generator: torch.Generator) -> Poses:
    choices = [sample_poses(domain, region, count, generator) for region in regions]
    pick = torch.randint(0, len(choices), (count,), generator=generator, device=generator.device)
    rows = torch.arange(count, device=generator.device)
    return Poses(torch.stack([c.position for c in choices])[pick, rows],
                 torch.stack([c.quaternion for c in choices])[pick, rows])


def _turned_little(domain: Domain, starts: Poses, goals: Poses, generator: torch.Generator) -> Poses:
    """The goals with the starts' orientation, half of them a quarter turn about one of the object's axes away, all yawed."""
    count, device = len(starts.position), generator.device
    axis = torch.randint(1, 4, (count,), generator=generator, device=device)
    half = torch.randint(-1, 2, (count,), generator=generator, device=device) * (pi / 4)
    half = half * (torch.rand(count, generator=generator, device=device) < 0.75)
    turn = torch.zeros(count, 4, device=device)
    turn[:, 0] = torch.cos(half)
    turn.scatter_(1, axis[:, None], torch.sin(half)[:, None])
    yaw = yaw_quaternion(uniform(count, (-pi / 4, pi / 4), generator))
    quaternion = quaternion_multiply(yaw, quaternion_multiply(starts.quaternion, turn))
    # A quarter turn of a box that is no cube changes the height of its centre.
    half_size = torch.tensor(domain.half_size, device=device)
    resting = [(matrix_from_quaternion(q)[:, 2].abs() * half_size).sum(-1) for q in (goals.quaternion, quaternion)]
    position = goals.position.clone()
    position[:, 2] += resting[1] - resting[0]
    return Poses(position, quaternion)
