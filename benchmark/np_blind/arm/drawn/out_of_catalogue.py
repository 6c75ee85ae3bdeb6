"""Which faults out of the catalogue a set draws, and giving them to arms. A fair judge calls none of them by its names."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from np_blind.arm.drawn.background import WIDE_FROM
from np_blind.arm.drawn.faults import Fault, Parameters
from np_blind.arm.drawn.out_of_catalogue_kinds import FIRST, LATER, NEWEST, SCALE
from np_blind.arm.drawn.out_of_catalogue_wide import WIDE
from np_blind.arm.plant.physics import Physics

LATER_FROM = 100  # seed from which on sets have the kinds that were added after the first doctor
ALL_FROM = 200  # seed from which on they have all kinds of those days, with those added after the doctor had met the later ones
OLD_BETWEEN = 6  # of the kinds before, drawn each time that all of the wide sets' own have been

BEFORE = FIRST | LATER | NEWEST
OUT_OF_CATALOGUE = BEFORE | WIDE
"""By name: what gives an arm the fault, and the joints (0..6) where it is drawn."""


def kinds_of(seed: int) -> tuple[str, ...]:
    """The kinds that sets of a seed may have.

    They are those that the first doctor was developed on, or only later ones, or all that there were, or all that there are.
    """
    if seed >= WIDE_FROM:
        return tuple(OUT_OF_CATALOGUE)
    return tuple(FIRST if seed < LATER_FROM else LATER if seed < ALL_FROM else BEFORE)


def deal(seed: int, rng: np.random.Generator) -> Iterator[str]:
    """Kinds in random order, for ever: all of them before any comes again.

    From `WIDE_FROM` on: all new ones, then some of the old ones, then all new ones again.
    """
    while True:
        if seed < WIDE_FROM:
            yield from map(str, rng.permutation(kinds_of(seed)))
        else:
            yield from map(str, rng.permutation(tuple(WIDE)))
            yield from map(str, rng.permutation(tuple(BEFORE))[:OLD_BETWEEN])


def apply_out_of_catalogue(physics: Physics, arm: int, fault: Fault, rng: np.random.Generator) -> Parameters:
    """Give an arm the fault that is in no catalogue; what exactly it got."""
    function, _ = OUT_OF_CATALOGUE[fault.effect]
    return function(physics, arm, fault.joint, fault.size * SCALE[fault.joint], rng)
