"""Episodes without a pre-contact policy (paper's comparison): the hand begins at one side of the object."""

from __future__ import annotations

import torch

from np_training.environment import contact
from np_training.setting import STARTS


class FixedContact:
    """Stands in for the pre-contact policy: closed fingertips, in the middle of their ranges otherwise,
    before the point of the object's surface that lies in a fixed direction."""

    def __init__(self, start: str) -> None:
        if STARTS.get(start) is None:
            raise ValueError(f"start: expected one of {', '.join(list(STARTS)[1:])}, got {start!r}")
        self.action = torch.zeros(contact.SIZE)
        self.action[3] = -1.0
        self.action[6:] = torch.tensor(STARTS[start])

    def __call__(self, state: torch.Tensor) -> torch.Tensor:
        """The action (n, 9) for states (n, 18), of which only the number matters."""
        return self.action.to(state).repeat(len(state), 1)

    def act(self, state: torch.Tensor, explore: float = 0.0) -> tuple[torch.Tensor, torch.Tensor]:
        """The action (n, 9) and its log-probability (n,), 0; there is nothing to explore."""
        return self(state), state.new_zeros(len(state))
