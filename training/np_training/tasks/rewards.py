"""The reward, term by term.

The paper's own reward pays nearness to the goal every step. Here a potential stands in its place, paid as a difference, so that only
progress pays and the optimum is to finish (Ng et al., 1999). Three more potentials leave that optimum where it is: the distance
itself, because its inverse is flat far from the goal; the angle to the goal, because the mean distance of the corners hardly depends
on it while it is large; and the hand's distance from the object. The paper's C1 (.02 m), C2 (1000) and C4 (-100) are here too. Its C3
(.03) weighs how near the fingers are to the object; here the same number is the price of stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING

from np_policy.action import normalise_stiffness

if TYPE_CHECKING:
    import torch  # slow, and nothing here but its tensors is meant

FORCE_FREE, FORCE_SPAN = 15.0, 15.0  # N: up to which a touch is free; beyond that, where half of the price is charged
TOUCH_SPEED = 0.08  # m/s: the hand's effective mass of some 4 kg then gives 30 N over the reflex's filter
BARE_FIRST = 0.25  # share of the price of housing and links that is charged from the beginning


@dataclass(frozen=True)
class Measures:
    """How far the episodes (n,) are from their goals."""

    distance: torch.Tensor
    """Mean over the object's corners or, where only the position counts, of its centre, m (n,)."""
    angle: torch.Tensor
    """Of rotation, rad (n,); 0 where it does not count."""
    hand: torch.Tensor
    """From the object's centre to T_E, the middle between the fingertips, m (n,)."""
    corners: torch.Tensor
    """Of each of the object's corners, m (n, 8)."""


@dataclass(frozen=True)
class PeriodTouch:
    """What the robot felt in a step, in worlds (n,)."""

    force: torch.Tensor
    """Largest filtered external force at the hand, N."""
    speed: torch.Tensor
    """Speed of a first touch along its force, m/s; 0 without one."""
    bare: torch.Tensor
    """Whether housing or links touched the object."""
    finger: torch.Tensor
    """Whether fingertips touched the object."""
    strictness: float = 1.0
    """How much of the prices on how a task is done is charged, 0 to 1: it rises with the curriculum, so that a policy learns to touch first."""


def saturating(share: torch.Tensor) -> torch.Tensor:
    """0 up to a share of 0, with slope 0 there, 1/2 at a share of 1, towards 1 beyond: no blow costs more than not finishing."""
    square = share.clamp(min=0).square()
    return square / (1 + square)


@dataclass(frozen=True)
class RewardConfig:
    """Weights of the terms; what a robot must not do has a negative one."""

    distance: float = 0.02
    """C1 of the paper, m."""
    success: float = 1000.0
    """C2 of the paper, for finishing."""
    gains: float = 0.03
    """C3 of the paper, here for each joint at its largest stiffness, a step."""
    failure: float = -100.0
    """C4 of the paper, for a lost object, a stop, or a contact that cannot be reached."""
    bare: float = -10.0
    """A step in which housing or links touch the object: they are hard, smooth and not made for it."""
    force: float = -10.0
    """A step at a filtered force far beyond FORCE_FREE; half of it FORCE_SPAN beyond."""
    touch: float = -20.0
    """A first touch far faster than TOUCH_SPEED; half of it at that speed."""
    change: float = 0.0
    """Of the squared change of the pose residual in a step, in shares of its limits: 24 where all six go from one end to the other. So a policy works an object loose by a simulator's own friction."""
    hidden: float = 0.0
    """A step at whose end the arm hides every corner from the camera; less where it hides fewer (`Sight`)."""
    progress: float = 10.0
    """Of the potential of the corners' distance."""
    far: float = 0.0
    """Of the potential of the distance itself, for 1 m."""
    turn: float = 150.0
    """Of the potential of the angle, for half a turn."""
    reach: float = 10.0
    """Of the potential of the hand's distance, for 0.1 m."""
    scale: float = 0.02
    """Of the sum, for the value network's sake."""

    def potentials(self, measures: Measures) -> dict[str, torch.Tensor]:
        """The potential (n,) of each measure; higher is nearer."""
        return {
            "progress": self.progress / (self.distance + measures.distance),
            "far": -self.far * measures.distance,
            "turn": -self.turn * measures.angle / pi,
            "reach": -self.reach * measures.hand / 0.1,
        }

    def terms(
        self,
        before: Measures,
        after: Measures,
        success: torch.Tensor,
        lost: torch.Tensor,
        stiffness: torch.Tensor,
        touch: PeriodTouch,
        change: torch.Tensor,
        hidden: torch.Tensor,
    ) -> dict[str, torch.Tensor]:
        """Each term (n,), scaled. before, after: around the step; success, lost (n,) bool; stiffness (n, 7) Nm/rad; touch: what the robot felt;
        change (n, 6): of the pose residual since the last step, in [-2, 2];
        hidden (n,): how far the camera is from seeing enough, 0 to 1. Of several steps at once, (t, n) stands in the place of (n,)."""
        old, new = self.potentials(before), self.potentials(after)
        terms = {name: new[name] - old[name] for name in new} | {
            "success": self.success * success,
            "gains": -self.gains * normalise_stiffness(stiffness).sum(-1),
            "failure": self.failure * lost,
            "bare": self.bare * (BARE_FIRST + (1 - BARE_FIRST) * touch.strictness) * touch.bare,
            "force": self.force * touch.strictness * saturating((touch.force - FORCE_FREE) / FORCE_SPAN),
            "touch": self.touch * touch.strictness * saturating(touch.speed / TOUCH_SPEED),
            "change": -self.change * touch.strictness * (change * change).sum(-1),
            "hidden": -self.hidden * touch.strictness * hidden,
        }
        return {name: self.scale * term for name, term in terms.items()}
