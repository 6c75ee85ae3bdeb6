"""The pool that episodes begin from: drawn once a rollout, used up from the front."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch

from np_training.environment.contact import Contacts
from np_training.tasks.practice import Tasks


@dataclass
class Starts:
    """A pool of episode starts: tasks, pre-contact state and action with its log-probability, contact; joints q (n, 7) rad
    that the approach ends at, goal_corners (n, 8, 3) m, and quarter turns to the goal, tips (n,)."""

    tasks: Tasks
    state: torch.Tensor
    action: torch.Tensor
    log_probability: torch.Tensor
    contacts: Contacts
    q: torch.Tensor
    goal_corners: torch.Tensor
    tips: torch.Tensor
    next: int = 0
    usable: torch.Tensor = field(init=False)

    def __post_init__(self) -> None:
        self.usable = self.contacts.feasible.nonzero()[:, 0]

    def take(self, count: int) -> torch.Tensor:
        """Rows of the next `count` usable starts; wraps around a pool that is used up. Raises ValueError without any."""
        if not len(self.usable):
            raise ValueError(
                f"starts: expected at least one feasible contact among {len(self.action)}, found none; "
                "draw a larger pool"
            )
        rows = (torch.arange(count, device=self.usable.device) + self.next) % len(self.usable)
        self.next += count
        return self.usable[rows]

    def rejected(self) -> torch.Tensor:
        """Rows without a usable contact among those passed over so far."""
        if self.next == 0:
            return self.usable[:0]
        reached = self.usable[min(self.next, len(self.usable)) - 1]
        return (~self.contacts.feasible[:reached]).nonzero()[:, 0]
