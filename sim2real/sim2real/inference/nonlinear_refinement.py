"""Nonlinear parameters (shapes) of the chosen effects are estimated before the result, and the search is repeated.

The search has a shape (a stroke, a lag, a speed) on a grid only. Between two values of the grid the nearest one
leaves a residual of its own, and a second effect that takes it up predicts better although nothing is there. So the
shapes of the chosen effects are settled by likelihood, all models are scored again with them, and members that are
then not needed are removed.
"""

from __future__ import annotations

from dataclasses import replace

from sim2real.effects.regressor import EffectRegressor
from sim2real.inference.estimates import refine_nonlinear_parameter, replace_regressor
from sim2real.inference.regression import RegressionProblem
from sim2real.inference.search import ModelSearch, ScoredModel

RESCORED = 200.0  # nats behind the best within which models are scored again with refined shapes


def refine_nonlinear_parameters(search: ModelSearch, chosen: ScoredModel) -> tuple[ModelSearch, ScoredModel]:
    """A search with the chosen model's shapes at their greatest likelihood, and the model that it chooses.

    Shapes are settled one after the other, that of the effect which explains most alone first, each in a model with those
    before it and the background only: together with an effect that takes up its misfit, it would settle where that effect
    is kept.
    """
    shaped = [m for m in chosen.members if search.design.candidates[m].effect.nonlinear is not None]
    if len(shaped) > 1:
        alone = {m: _settled(search, search.background, m) for m in shaped}
        shaped.sort(key=lambda m: -alone[m].value(alone[m].model((*search.background, m))))
    trial = search
    for number, m in enumerate(shaped):
        trial = _settled(trial, (*search.background, *shaped[:number]), m)
    if trial is search:
        return search, chosen
    # Models that were far behind are not scored again: they do not affect the result.
    least = max(map(search.value, search.tried.values())) - RESCORED
    for members, model in search.tried.items():
        if search.value(model) > least:
            trial.model(members)
    return trial, trial.prune(trial.model(chosen.members))


def _settled(search: ModelSearch, beside: tuple[int, ...], member: int) -> ModelSearch:
    """The search with the shape of one candidate settled beside these others; as it is where that is its own."""
    effect = refine_nonlinear_parameter(search, search.model((*beside, member)), member)
    candidate = search.design.candidates[member]
    if effect is candidate.effect:
        return search
    return search.with_regression(_replaced(search.design, member, effect), member)


def _replaced(design: RegressionProblem, member: int, effect: EffectRegressor) -> RegressionProblem:
    """The design with another effect, of the same parameters, in the place of a candidate's."""
    candidate = design.candidates[member]
    candidates = list(design.candidates)
    candidates[member] = replace(candidate, effect=effect)
    cells = tuple(replace_regressor(design, list(design.cells), candidate, effect))
    return replace(design, cells=cells, candidates=tuple(candidates))
