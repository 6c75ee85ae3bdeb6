"""What sort of task an episode is: how often its object is to be tipped, how far turned, and in which goal region it ends."""

from __future__ import annotations

from math import degrees, pi

import torch

from np_common.rotations import rotation_angle
from np_description.domains import Task
from np_training.tasks.poses import Poses, quarter_tips


def goal_region(domain: Task, position: torch.Tensor) -> torch.Tensor:
    """Index (n,) of the domain's goal region that the object's centres (n, 3) m lie in, or nearest to."""

    def beyond(value: torch.Tensor, bounds: tuple[float, float]) -> torch.Tensor:
        return (bounds[0] - value).clamp(min=0) + (value - bounds[1]).clamp(min=0)

    least, most = min(domain.half_size), max(domain.half_size)
    distances = [
        beyond(position[:, 0], region.x)
        + beyond(position[:, 1], region.y)
        + beyond(position[:, 2] - region.surface, (least, most))
        for region in domain.goals
    ]
    return torch.stack(distances).argmin(0)


def groups(domain: Task, tips: torch.Tensor, goal_position: torch.Tensor) -> dict[str, torch.Tensor]:
    """Masks (n,) of the groups of episodes, by name, for quarter turns `tips` (n,) and goals at (n, 3) m.

    tips0, tips1, tips2 where the domain turns its object over; goal0, goal1, ... where it has several goal
    regions.
    """
    masks = {f"tips{k}": tips == k for k in range(3)} if domain.start.quarter_turns else {}
    if len(domain.goals) > 1:
        region = goal_region(domain, goal_position)
        masks |= {f"goal{k}": region == k for k in range(len(domain.goals))}
    return masks


def groups_of_tasks(domain: Task, starts: Poses, goals: Poses) -> dict[str, torch.Tensor]:
    """`groups` of tasks (n,), and where the domain sets how far a goal is turned turn45, turn90, ...: by more than the one before and
    by up to so many degrees."""
    masks = groups(domain, quarter_tips(starts, goals), goals.position)
    if domain.goal_yaw is not None:
        angle, width = rotation_angle(starts.quaternion, goals.quaternion), pi / 4
        for k in range(4):
            masks[f"turn{degrees((k + 1) * width):.0f}"] = (angle > k * width) & (
                angle <= (k + 1) * width + 1e-3 * (k == 3)
            )
    return masks
