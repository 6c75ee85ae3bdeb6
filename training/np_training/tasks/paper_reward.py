"""The paper's reward, as it prints it (Kim et al., IROS 2023): `--reward paper`.

    sum over the eight corners of C1 / (|x_o - x_g| + C1)  -  |k_p|  +  C2 on success  +  C3 / |mean of the fingers - object|

every step, and C4 where the pre-contact policy chose a contact that cannot be reached. C1 .02 m, C2 1000, C3 .03 m and C4 -100 are
printed. Not printed, and read like this:

- |k_p| has no weight: 1. Nor has k_p a unit: it is the share of the range of each joint's stiffness, so that the norm is at most
  2.65, beside at most 8 of the corners. In Nm/rad it would be 82 to 819: the best an episode could do would be to end.
- The fingers' mean is T_E, which lies in the middle between the fingertips; the object is its centre.
- An object that leaves the table, and the robot's reflex, end an episode and cost nothing but the rest of it.
- The corners count on the wall too, where success asks for the position alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from np_policy.action import normalised_stiffness
from np_training.tasks.rewards import Measures

if TYPE_CHECKING:
    import torch  # slow, and nothing here but its tensors is meant


@dataclass(frozen=True)
class PaperReward:
    """distance (C1, m), success (C2), fingers (C3, m), failure (C4), gains: of the norm of the stiffnesses; scale: of the sum, for the
    value network's sake, the same as that of `RewardConfig`: which of two policies is better does not depend on it."""

    name: ClassVar[str] = "paper"

    distance: float = 0.02
    success: float = 1000.0
    fingers: float = 0.03
    failure: float = -100.0
    gains: float = 1.0
    scale: float = 0.02

    def terms(
        self,
        before: Measures,
        after: Measures,
        success: torch.Tensor,
        lost: torch.Tensor,
        stiffness: torch.Tensor,
        bare: torch.Tensor,
        change: torch.Tensor,
        hidden: torch.Tensor,
    ) -> dict[str, torch.Tensor]:
        """Each term (n,), scaled. after: at the end of the step; success (n,) bool; stiffness (n, 7) Nm/rad. What was before, what is
        lost, what the housing touches, how the action changes and what the camera sees cost nothing here."""
        terms = {
            "corners": (self.distance / (after.corners + self.distance)).sum(-1),
            "gains": -self.gains * normalised_stiffness(stiffness).norm(dim=-1),
            "success": self.success * success,
            "fingers": self.fingers / after.hand,
        }
        return {name: self.scale * term for name, term in terms.items()}
