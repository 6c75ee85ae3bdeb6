"""The reward, term by term.

The constants are the paper's: C1 .02, C2 1000, C3 .03, C4 -100. The published text gives the constants but not how the
distance term is spread over time; paid every step, 1 / (C1 + d) makes hovering beside the goal worth more than
finishing. Here it is a potential, paid as a difference, so that only progress pays and the optimum is to finish.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from np_policy.action import normalised_stiffness


@dataclass(frozen=True)
class RewardConfig:
    """distance (C1, m), success (C2), gains (C3, a joint), failure (C4: lost object, no collision-free contact);
    progress: weight of the potential; scale: of the sum, for the value network's sake."""

    distance: float = 0.02
    success: float = 1000.0
    gains: float = 0.03
    failure: float = -100.0
    progress: float = 10.0
    scale: float = 0.02


def potential(config: RewardConfig, corner_distance: torch.Tensor) -> torch.Tensor:
    """1 / (C1 + d), d (n,) m the mean distance of the object's corners from their goals."""
    return 1 / (config.distance + corner_distance)


def reward_terms(config: RewardConfig, before: torch.Tensor, after: torch.Tensor, success: torch.Tensor,
                 lost: torch.Tensor, stiffness: torch.Tensor) -> dict[str, torch.Tensor]:
    """Each term (n,), scaled. before, after (n,) m: mean corner distances around the step; success, lost (n,) bool;
    stiffness (n, 7) Nm/rad."""
    progress = potential(config, after) - potential(config, before)
    terms = {
        "progress": config.progress * progress,
        "success": config.success * success,
        "gains": -config.gains * normalised_stiffness(stiffness).sum(-1),
        "failure": config.failure * lost,
    }
    return {name: config.scale * term for name, term in terms.items()}
