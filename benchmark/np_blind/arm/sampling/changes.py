"""What changed between two days: the truth of a change is against the arm as it was, what differs by itself included."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from np_blind.arm.plant.physics import Physics
from np_blind.arm.plant.rigid_arm import nominal_inertials
from np_blind.arm.sampling.faults import Fault, Parameters

FIRST_DAY, SECOND_DAY = 1, 2


def _friction(*names: str) -> Callable[[Physics, int, int], float]:
    return lambda p, i, j: float(np.mean([getattr(p, name)[i, j] for name in names]))


def _inertia(p: Physics, i: int, j: int) -> float:
    return float(np.trace(p.inertials.inertia[i, j]) / np.trace(nominal_inertials(1).inertia[0, j]))


# Parameters whose value in an arm is not the fault's alone, and how to read it off.
_LEVELS: dict[str, dict[str, Callable]] = {
    "coulomb_friction": {"level": _friction("coulomb_forward", "coulomb_backward")},
    "asymmetric_coulomb_friction": {
        "level_positive": _friction("coulomb_forward"),
        "level_negative": _friction("coulomb_backward"),
    },
    "viscous_friction": {"coefficient": _friction("viscous_forward", "viscous_backward")},
    "asymmetric_viscous_friction": {
        "coefficient_positive": _friction("viscous_forward"),
        "coefficient_negative": _friction("viscous_backward"),
    },
    "link_inertia": {"scale": _inertia},
    "command_delay": {"delay": lambda p, i, _: float(p.command_delay[i])},
}


def read_levels(physics: Physics, arm: int, fault: Fault) -> dict[str, float]:
    """What an arm has, by parameter, of what a fault changes; of those that background and earlier faults may have moved."""
    return {name: read(physics, arm, fault.joint) for name, read in _LEVELS.get(fault.effect, {}).items()}


def change_between_sessions(given: Parameters, before: dict[str, float], after: dict[str, float]) -> Parameters:
    """What a fault was given, as the change between the levels of two days where it has any."""
    return given | {name: (after[name] - before[name], given[name][1]) for name in after}
