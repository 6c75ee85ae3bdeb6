"""Shapes settled before the answer: what a coarse variant leaves, no other effect shall be called for.

The competition knows shapes (a stroke, a lag, a speed) on a grid. Between two of its values the nearest one
leaves a residual of its own, and a second effect that takes it up predicts better, although nothing is there.
So the shapes of the chosen effects are settled by likelihood, all structures are scored again with them, and
what is superfluous then goes.
"""

from __future__ import annotations

from dataclasses import replace

from np_diagnosis.inference.design import Design
from np_diagnosis.inference.estimates import settled, with_effect
from np_diagnosis.inference.search import Search, Structure
from np_effects.signature import Signature as Effect


def settle_shapes(search: Search, chosen: Structure) -> tuple[Search, Structure]:
    """The search with the chosen structure's shapes where the likelihood is greatest, and what it chooses.

    The effect that says most alone, its shape settled, comes first, and each beside those before it only: beside
    what takes up its misfit it would settle on keeping that.
    """
    shaped = [m for m in chosen.members if search.design.candidates[m].effect.shape is not None]
    if len(shaped) > 1:
        alone = {m: _settled(search, (), m) for m in shaped}
        shaped.sort(key=lambda m: -alone[m].value(alone[m].structure((m,))))
    trial = search
    for number, m in enumerate(shaped):
        trial = _settled(trial, tuple(shaped[:number]), m)
    if trial is search:
        return search, chosen
    for members in search.tried:
        trial.structure(members)
    return trial, trial.pruned(trial.structure(chosen.members))


def _settled(search: Search, beside: tuple[int, ...], member: int) -> Search:
    """The search with the shape of one candidate settled beside these others; as it is where that is its own."""
    effect = settled(search, search.structure((*beside, member)), member)
    candidate = search.design.candidates[member]
    if effect is candidate.effect:
        return search
    return search.on(_replaced(search.design, member, effect), search.reach(candidate))


def _replaced(design: Design, member: int, effect: Effect) -> Design:
    """The design with another effect, of the same parameters, in the place of a candidate's."""
    candidate = design.candidates[member]
    candidates = list(design.candidates)
    candidates[member] = replace(candidate, effect=effect)
    cells = tuple(with_effect(design, list(design.cells), candidate, effect))
    return replace(design, cells=cells, candidates=tuple(candidates))
