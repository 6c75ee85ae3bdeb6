"""Which faults out of the catalogue a set draws, and giving them to arms. A fair judge calls none of them by its names."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from np_blind.arm.plant.physics import Physics
from np_blind.arm.sampling.faults import Fault, Parameters
from np_blind.arm.sampling.unknown_fault_kinds import FIRST, LATER, NEWEST, SCALE
from np_blind.arm.sampling.unknown_fault_kinds_wide import WIDE

OLD_BETWEEN = 6  # of the other kinds, drawn each time that all of WIDE have been

BEFORE = FIRST | LATER | NEWEST
UNKNOWN_FAULTS = BEFORE | WIDE
"""By name: what gives an arm the fault, and the joints (0..6) where it is drawn."""


def draw_unknown_faults(rng: np.random.Generator) -> Iterator[str]:
    """Kinds in random order, for ever: all of WIDE, then some of the others, then all of WIDE again."""
    while True:
        yield from map(str, rng.permutation(tuple(WIDE)))
        yield from map(str, rng.permutation(tuple(BEFORE))[:OLD_BETWEEN])


def apply_unknown_fault(physics: Physics, arm: int, fault: Fault, rng: np.random.Generator) -> Parameters:
    """Give an arm the fault that is in no catalogue; what exactly it got."""
    function, _ = UNKNOWN_FAULTS[fault.effect]
    return function(physics, arm, fault.joint, fault.size * SCALE[fault.joint], rng)
