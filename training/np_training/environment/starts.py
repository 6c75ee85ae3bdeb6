"""The pool that episodes begin from: drawn once a rollout, used up from the front."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch

from np_common.rotations import matrix_from_vector
from np_description.domains import Task
from np_description.hand import HandShapes
from np_training.environment.contact import Contacts, gripper_clearance
from np_training.physics.batched_kinematics import solve_ik
from np_training.tasks.practice import Tasks
from np_training.tasks.randomisation import Conditions


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


def miss_contacts(
    domain: Task, hand: HandShapes, c: Conditions, tasks: Tasks, contacts: Contacts, generator: torch.Generator
) -> torch.Tensor:
    """Joints (n, 7) rad where approaches to the contacts end: the approach of the real robot, and the student, miss the teacher's pose by
    a little."""
    if not (c.start_position or c.start_rotation):
        return contacts.q
    n, device = len(contacts.q), generator.device
    shift = c.start_position * (2 * torch.rand(n, 3, generator=generator, device=device) - 1)
    shift[:, 2] = shift[:, 2].abs()
    turn = matrix_from_vector(c.start_rotation * torch.randn(n, 3, generator=generator, device=device))
    missed = solve_ik(contacts.q, contacts.position + shift, turn @ contacts.rotation)
    free = gripper_clearance(domain, missed, contacts.width, tasks.starts, tasks.sunk, hand) > 0
    return torch.where(free[:, None], missed, contacts.q)
