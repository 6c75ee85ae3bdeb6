"""Start and goal poses of a domain in batches: the regions of np_description.domains, drawn with PyTorch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import torch

from np_common.rotations import matrix_from_quaternion, quaternion_multiply, yaw_quaternion
from np_description.domains import Region, Task


@dataclass(frozen=True)
class Poses:
    """position (n, 3) m and quaternion wxyz (n, 4), base frame; scale (n, 3): how many times as long the object's edges are there
    as the domain's own (None: once)."""

    position: torch.Tensor
    quaternion: torch.Tensor
    scale: torch.Tensor | None = None

    def __getitem__(self, index) -> Poses:
        return Poses(self.position[index], self.quaternion[index], None if self.scale is None else self.scale[index])

    def half_size(self, domain: Task) -> torch.Tensor:
        """Of the objects, (3,) or (n, 3) m."""
        half = torch.tensor(domain.half_size, dtype=self.position.dtype, device=self.position.device)
        return half if self.scale is None else half * self.scale


def uniform(count: int, bounds: tuple[float, float], generator: torch.Generator) -> torch.Tensor:
    """(count,) numbers, uniform in bounds, on the generator's device."""
    low, high = bounds
    return low + (high - low) * torch.rand(count, generator=generator, device=generator.device)


def edges(count: int, bounds: tuple[float, float], generator: torch.Generator) -> torch.Tensor:
    """Factors (count, 3) of an object's edges, each uniform in bounds."""
    return uniform(3 * count, bounds, generator).reshape(count, 3)


def sample_poses(domain: Task, region: Region, count: int, generator: torch.Generator) -> Poses:
    """(count,) poses at rest in a region."""
    quaternion = yaw_quaternion(uniform(count, region.yaw, generator))
    for axis, angle in ((2, region.pitch), (1, 0.0)):  # pitch, then roll, in the rotated frame: yaw * pitch * roll
        half = torch.full((count,), angle / 2, device=generator.device)
        if region.quarter_turns:
            half = torch.randint(0, 4, (count,), generator=generator, device=generator.device) * (pi / 4)
        turn = torch.zeros(count, 4, device=generator.device)
        turn[:, 0], turn[:, axis] = torch.cos(half), torch.sin(half)
        quaternion = quaternion_multiply(quaternion, turn)
    half_size = torch.tensor(domain.half_size, device=generator.device)
    height = region.surface + (matrix_from_quaternion(quaternion)[:, 2].abs() * half_size).sum(-1)
    position = torch.stack([uniform(count, region.x, generator), uniform(count, region.y, generator), height], dim=-1)
    return Poses(position, quaternion)


def sample_tasks(domain: Task, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
    """(count,) starts and goals of the domain; tasks closer than its least distance are drawn again."""
    return draw_distant(_draw, domain, count, generator)


def quarter_tips(starts: Poses, goals: Poses) -> torch.Tensor:
    """How many quarter turns (n,), 0 to 2, bring the face that points up at the goal up from where it is at the start."""
    up = (matrix_from_quaternion(starts.quaternion)[:, 2] * matrix_from_quaternion(goals.quaternion)[:, 2]).sum(-1)
    return torch.round(torch.acos(up.clamp(-1, 1)) / (pi / 2)).long()


def draw_distant(
    draw: Callable[..., tuple[Poses, Poses]], domain: Task, count: int, generator: torch.Generator
) -> tuple[Poses, Poses]:
    """What `draw(domain, count, generator)` gives, with tasks closer than the domain's least distance drawn again."""
    starts, goals = draw(domain, count, generator)
    while True:
        near = (starts.position - goals.position).norm(dim=-1) < domain.min_distance
        again = int(near.sum())
        if not again:
            return starts, goals
        new_starts, new_goals = draw(domain, again, generator)
        for old, new in ((starts, new_starts), (goals, new_goals)):
            old.position[near], old.quaternion[near] = new.position, new.quaternion


def _draw(domain: Task, count: int, generator: torch.Generator) -> tuple[Poses, Poses]:
    starts = sample_poses(domain, domain.start, count, generator)
    goals = from_any(domain, domain.goals, count, generator)
    if domain.goal_yaw is not None:
        turn = yaw_quaternion(uniform(count, domain.goal_yaw, generator))
        goals = Poses(goals.position, quaternion_multiply(turn, starts.quaternion))
    return starts, goals


def from_any(domain: Task, regions: tuple[Region, ...], count: int, generator: torch.Generator) -> Poses:
    """(count,) poses at rest, each in one of the regions, with equal odds."""
    choices = [sample_poses(domain, region, count, generator) for region in regions]
    pick = torch.randint(0, len(choices), (count,), generator=generator, device=generator.device)
    rows = torch.arange(count, device=generator.device)
    return Poses(
        torch.stack([c.position for c in choices])[pick, rows], torch.stack([c.quaternion for c in choices])[pick, rows]
    )
