"""The arm's own numbers: load, level of the base and joint friction with their intervals, whether the diagnosis names them or not.

Each is estimated beside all that the diagnosis has found. So it also serves for an arm without a gap: it shows whether the load
set in the controller is true, and whether the base is level.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim2real.arm.model import Arm
from sim2real.diagnosis import Diagnosis
from sim2real.inference.estimates import Estimate, estimate
from sim2real.inference.regression import Candidate

LOAD_AND_BASE = ("payload", "base_tilt")
COULOMB, VISCOUS = "coulomb_friction", "viscous_friction"
SPEED_FRICTION = (
    COULOMB,
    VISCOUS,
    "asymmetric_coulomb_friction",
    "asymmetric_viscous_friction",
    "stribeck_friction",
    "friction_curve",
)
"""Laws of friction by speed alone: one pair of Coulomb and viscous friction stands in their place."""


@dataclass(frozen=True)
class ArmNumber:
    """One quantity of the arm."""

    quantity: str
    """Load, roll or pitch of the base, Coulomb or viscous friction."""
    component: str
    """Joint name, or arm."""
    nominal: float
    """What the nominal arm has of it, in the unit of the estimate."""
    estimate: Estimate
    """What these recordings show, the nominal value included."""


def estimate_arm_numbers(diagnosis: Diagnosis) -> list[ArmNumber]:
    """Load, tilt and friction of the arm that was recorded.

    What the motion does not excite is left out. A change between recordings has none: its reference is no nominal arm.
    """
    search, chosen = diagnosis.search, diagnosis.chosen
    candidates, arm = diagnosis.design.candidates, diagnosis.context.arm
    if diagnosis.context.reference:
        return []

    def find(effect: str, joint: int | None) -> int | None:
        numbers = (n for n, c in enumerate(candidates) if c.effect.id == effect and c.joint == joint)
        return next((n for n in numbers if search.joints_affected(candidates[n])), None)

    whole_arm = [n for n in (find(effect, None) for effect in LOAD_AND_BASE) if n is not None]
    by_joint = [
        n for j in np.flatnonzero(diagnosis.gap.moved) for n in (find(COULOMB, j), find(VISCOUS, j)) if n is not None
    ]
    others = (m for m in chosen.members if candidates[m].effect.id not in SPEED_FRICTION)
    model = search.model(tuple({*others, *whole_arm, *by_joint}))
    found = []
    for number in (*whole_arm, *by_joint):
        candidate = candidates[number]
        for name, change in estimate(search, model, number, 0, refined=False)[1].items():
            quantity = {"mass": "load", "roll": "base_roll", "pitch": "base_pitch"}.get(name, candidate.effect.id)
            nominal = 0.0 if candidate.joint is None else float(_nominal_friction(arm, candidate))
            shown = Estimate(change.value + nominal, change.low + nominal, change.high + nominal, change.unit)
            found.append(ArmNumber(quantity, candidate.component(arm.joints), nominal, shown))
    return found


def _nominal_friction(arm: Arm, candidate: Candidate) -> float:
    return (arm.frictionloss if candidate.effect.id == COULOMB else arm.damping)[candidate.joint]
