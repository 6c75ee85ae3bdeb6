"""Shapes settled before the answer: what an effect's coarse variant leaves, no other effect shall be called for.

The competition knows shapes (a stroke, a lag, a speed) on a grid. Between two of its values the nearest one leaves
a residual of its own, and a second effect that takes it up predicts better, although nothing is there. So the shapes
of the chosen effects are settled by likelihood, all structures are scored again with them, and what is superfluous
then goes.
"""

from __future__ import annotations

from dataclasses import replace

from np_diagnosis.design import Design
from np_diagnosis.effects import Effect
from np_diagnosis.estimates import settled, with_effect
from np_diagnosis.search import Search, Structure


def settle_shapes(search: Search, chosen: Structure) -> tuple[Search, Structure]:
    """The search with the shapes of the chosen structure where the likelihood is greatest, and what it chooses."""
    design, changed = search.design, set()
    shaped = tuple(m for m in chosen.members if design.candidates[m].effect.shape is not None)
    alone = search.structure(shaped)  # beside what takes up their misfit they would settle on keeping it
    for m in shaped:
        effect = settled(search, alone, m)
        if effect is not design.candidates[m].effect:
            changed |= set(search.reach(design.candidates[m]))
            design = _replaced(design, m, effect)
    if not changed:
        return search, chosen
    again = search.on(design, changed)
    return again, again.pruned(again.structure(chosen.members))


def _replaced(design: Design, member: int, effect: Effect) -> Design:
    """The design with another effect, of the same parameters, in the place of a candidate's."""
    candidate = design.candidates[member]
    candidates = list(design.candidates)
    candidates[member] = replace(candidate, effect=effect)
    cells = tuple(with_effect(design, list(design.cells), candidate, effect))
    return replace(design, cells=cells, candidates=tuple(candidates))
