"""The reward, term by term.

The constants are the paper's: C1 .02, C2 1000, C3 .03, C4 -100. The published text gives the constants but not how the
distance term is spread over time; paid every step, 1 / (C1 + d) makes hovering beside the goal worth more than
finishing. Here it is a potential, paid as a difference, so that only progress pays and the optimum is to finish. Three
potentials of ours stand beside it, which leave that optimum where it is: the distance itself, because its inverse is flat
far from the goal; the angle to the goal, because the mean distance of the corners hardly depends on it while it is
large; and the hand's distance from the object.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import torch

from np_policy.action import normalised_stiffness


@dataclass(frozen=True)
class RewardConfig:
    """distance (C1, m), success (C2), gains (C3, a joint), failure (C4: lost object, no collision-free contact); bare (ours): a
    step at whose end housing or links touch the object, which are hard, smooth and not made for it; weights of the potentials: progress, far (for 1 m), turn (for half a turn), reach (for .1 m); scale: of the sum, for the value network's sake."""

    distance: float = 0.02
    success: float = 1000.0
    gains: float = 0.03
    failure: float = -100.0
    bare: float = -2.5
    progress: float = 10.0
    far: float = 0.0
    turn: float = 150.0
    reach: float = 10.0
    scale: float = 0.02


@dataclass(frozen=True)
class Measures:
    """How far the episodes (n,) are from their goals: distance m, the mean over the object's corners or, where only the
    position counts, that of its centre; angle rad, 0 where it does not count; hand: distance m of T_E from the object."""

    distance: torch.Tensor
    angle: torch.Tensor
    hand: torch.Tensor


def potentials(config: RewardConfig, measures: Measures) -> dict[str, torch.Tensor]:
    """The potential (n,) of each measure; higher is nearer."""
    return {
        "progress": config.progress / (config.distance + measures.distance),
        "far": -config.far * measures.distance,
        "turn": -config.turn * measures.angle / pi,
        "reach": -config.reach * measures.hand / 0.1,
    }


def reward_terms(
    config: RewardConfig,
    before: Measures,
    after: Measures,
    success: torch.Tensor,
    lost: torch.Tensor,
    stiffness: torch.Tensor,
    bare: torch.Tensor,
) -> dict[str, torch.Tensor]:
    """Each term (n,), scaled. before, after: around the step; success, lost (n,) bool; stiffness (n, 7) Nm/rad; bare (n,) bool:
    whether housing or links touch the object."""
    old, new = potentials(config, before), potentials(config, after)
    terms = {name: new[name] - old[name] for name in new} | {
        "success": config.success * success,
        "gains": -config.gains * normalised_stiffness(stiffness).sum(-1),
        "failure": config.failure * lost,
        "bare": config.bare * bare,
    }
    return {name: config.scale * term for name, term in terms.items()}
