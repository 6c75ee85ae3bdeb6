"""How large: values and 95 % intervals of an effect's parameters, its nonlinear parameter refined first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim2real.effects.registry import ARM_EFFECTS
from sim2real.effects.regressor import EffectRegressor
from sim2real.inference.bootstrap import draw_counts
from sim2real.inference.fit import ParameterFit, fit_parameters, parameter_indices, residual_sum_of_squares, sub_gram
from sim2real.inference.model_averaging import between_model_deviations
from sim2real.inference.regression import Candidate, RegressionProblem
from sim2real.inference.residual_cells import ResidualCell, make_cell
from sim2real.inference.search import ModelSearch, ScoredModel, average_absorbed, is_curve
from sim2real.thresholds import THRESHOLDS

ESTIMATES, CURRENT = THRESHOLDS.estimates, THRESHOLDS.current
BOOTSTRAPS = 200  # draws of the bootstrap over blocks
ROUNDS = 5  # of the secant method for a shape that is linear to first order
SETTLED_SHARE = 0.003  # distance of the coefficient from one at which a shape is final
SLOPE = -0.3  # flattest slope of the secant method
LONGEST_STEP = 1.0  # of the logarithm of a shape
STEPS = 12  # of the line search for any other shape
FIRST_STEP = 0.25  # of the line search, relative to the shape
NARROWING = 0.6  # of a step after one that found nothing better
SMALLEST_SHAPE = 0.2  # that an interval is drawn to, relative to the shape


@dataclass(frozen=True)
class Estimate:
    """A parameter's value with its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str

    @property
    def half_width(self) -> float:
        """Of the interval; of one that is cut at zero, of the side that is whole."""
        return max(self.high - self.value, self.value - self.low)

    def row(self) -> dict:
        """Value and 95 % interval, as reports have them."""
        return {"value": self.value, "ci95": [self.low, self.high]}


def cut_at_zero(effect: str, estimates: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """The estimates by name of an effect's parameters; the interval of a magnitude ends at zero, below which there is none.

    For a magnitude against the nominal arm, which has none of the effect; a change since another recording may be below zero. A true
    value from zero on lies in the interval as before. So does the estimate, be it below zero by what the nuisances absorb.
    """
    magnitudes = {q.name for q in ARM_EFFECTS[effect].quantities if q.is_magnitude}
    return {
        name: replace(one, low=max(one.low, min(0.0, one.value))) if name in magnitudes else one
        for name, one in estimates.items()
    }


def estimate(
    search: ModelSearch, model: ScoredModel, member: int, seed: int, refined: bool = True
) -> tuple[EffectRegressor, dict[str, Estimate]]:
    """(the effect with its nonlinear parameter refined, parameters by name) of a member of a model."""
    design = search.design
    candidate = design.candidates[member]
    joints, inside = next(g for g in search.groups(model.members) if member in g[1])
    ids = search.ids(joints, inside)
    cells = [_narrow(cell, ids) for j in joints for cell in design.cells_of(j)]
    shapes = [(candidate.effect, cells, 0.0)]
    if candidate.effect.nonlinear is not None and refined:
        shapes = _settle_all(design, cells, ids, candidate)
    key = (joints, inside, seed)
    beside_curve = any(is_curve(design.candidates[m]) for m in inside)
    estimates = []
    for effect, cells, width in shapes:
        if effect is not candidate.effect:
            whole, half = _interval(cells, ids, design, seed, beside_curve)
        else:  # of all members of the group that are as they were
            if key not in search.intervals:
                search.intervals[key] = _interval(cells, ids, design, seed, beside_curve)
            whole, half = (values.copy() for values in search.intervals[key])
        if width:
            half = np.hypot(half, _shift(design, cells, ids, candidate, effect, width))
        at = [int(np.flatnonzero(ids == i)[0]) for i in candidate.ids]
        found = _reported(design, effect, whole[at], half[at], width)
        if effect.absorbs:
            extra = average_absorbed(design, ids, whole, effect)
            found = {
                name: replace(e, value=e.value + extra, low=e.low + extra, high=e.high + extra)
                for name, e in found.items()
            }
        estimates.append(found)
    effect, found = shapes[0][0], _hull(estimates)
    if refined:
        unsure = between_model_deviations(search, joints, inside, member, seed)
        found = {name: _widened(e, ESTIMATES.t95 * unsure.get(name, 0.0)) for name, e in found.items()}
    return effect, found if design.context.reference else cut_at_zero(effect.id, found)


def _reported(
    design: RegressionProblem, effect: EffectRegressor, values: np.ndarray, half: np.ndarray, width: float
) -> dict[str, Estimate]:
    """Parameters by the names of reports, of coefficients (p,) and a shape with these half widths."""
    known = np.array([p.background for p in effect.parameters])
    share = np.hypot(effect.model, _unweighed(design, effect))
    half = np.hypot(np.hypot(half, ESTIMATES.t95 * known), share * np.abs(values))
    found = {
        p.name: Estimate(float(v), float(v - h), float(v + h), p.unit)
        for p, v, h in zip(effect.parameters, values, half)
    }
    nonlinear = effect.nonlinear
    if nonlinear is not None and nonlinear.linear:
        share = found.pop(effect.parameters[0].name)
        value, width = nonlinear.value * share.value, nonlinear.value * (share.high - share.value)
        width = float(np.hypot(width, ESTIMATES.t95 * nonlinear.background))
        found[nonlinear.name] = Estimate(value, value - width, value + width, nonlinear.unit)
    elif nonlinear is not None:
        found.pop("share", None)
        width = float(np.hypot(np.hypot(width, ESTIMATES.t95 * nonlinear.background), effect.model * nonlinear.value))
        value = float(nonlinear.value)
        found[nonlinear.name] = Estimate(value, value - width, value + width, nonlinear.unit)
    return found


def _hull(estimates: list[dict[str, Estimate]]) -> dict[str, Estimate]:
    """The first estimates, with intervals that hold those of all."""
    return {
        name: replace(
            one, low=min(other[name].low for other in estimates), high=max(other[name].high for other in estimates)
        )
        for name, one in estimates[0].items()
    }


def _widened(one: Estimate, half: float) -> Estimate:
    """An estimate with one more independent uncertainty, of this half width."""
    low, high = np.hypot(one.value - one.low, half), np.hypot(one.high - one.value, half)
    return replace(one, low=float(one.value - low), high=float(one.value + high))


def refine_nonlinear_parameter(search: ModelSearch, model: ScoredModel, member: int) -> EffectRegressor:
    """The effect of a member of a model with its nonlinear parameter where the likelihood is greatest."""
    design, candidate = search.design, search.design.candidates[member]
    if candidate.effect.nonlinear is None:
        return candidate.effect
    joints, inside = next(g for g in search.groups(model.members) if member in g[1])
    ids = search.ids(joints, inside)
    cells = [_narrow(cell, ids) for j in joints for cell in design.cells_of(j)]
    return _settle(design, cells, ids, candidate)[0]


def _interval(
    cells: list[ResidualCell], ids: np.ndarray, design: RegressionProblem, seed: int, beside_curve: bool
) -> tuple[np.ndarray, np.ndarray]:
    """(values (p,), half widths (p,)): from all blocks; the widest of posterior, bootstrap of blocks and `deviation_between_motions`.
    beside_curve: whether the group holds a friction curve (`_widen_beside_curve`)."""
    weights = draw_counts(len(design.blocks), BOOTSTRAPS, seed).astype(float)
    whole = _whole(cells, ids, design)
    drawn = fit_parameters(
        cells,
        [np.tensordot(weights, c.test, 1) for c in cells],
        [weights @ c.test_rows for c in cells],
        ids,
        design.parameters,
    )
    posterior = np.sqrt(np.diagonal(whole.covariance[0]))
    robust = deviation_between_motions(cells, ids, design, whole)
    values = whole.parameters[0]
    half = ESTIMATES.t95 * np.max([drawn.parameters.std(axis=0), posterior, robust], axis=0)
    return values, _widen_beside_curve(cells, ids, design, values, half) if beside_curve else half


def deviation_between_motions(
    cells: list[ResidualCell], ids: np.ndarray, design: RegressionProblem, whole: ParameterFit
) -> np.ndarray:
    """Standard deviation (p,) that allows for errors shared by all blocks of one motion (Liang and Zeger 1986).

    A model that is slightly wrong, as any law of friction is, errs alike in all blocks of a motion: between them its error
    does not show.
    """
    motions, motion = np.unique([block.trajectory for block in design.blocks], return_inverse=True)
    if len(motions) < 2:
        return np.zeros(len(ids))
    score = np.zeros((len(motions), len(ids)))  # gradient of the log likelihood
    for cell, variance in zip(cells, whole.variance):
        columns, at = parameter_indices(cell, ids)
        gram = sub_gram(cell.test, columns)
        gradient = (gram[:, 1:, 0] - gram[:, 1:, 1:] @ whole.parameters[0][at]) / variance
        np.add.at(score, (motion[:, None], at[None]), gradient)
    moved = score @ whole.covariance[0]
    return np.sqrt(len(motions) / (len(motions) - 1) * np.square(moved).sum(axis=0))


def _unweighed(design: RegressionProblem, effect: EffectRegressor) -> np.ndarray:
    """Half of a 95 % interval (p,), as a share of its value, of what a torque is known to that was made of a current."""
    if all(log.per_ampere is None for log in design.context.logs):
        return np.zeros(len(effect.parameters))
    is_force = [any(unit in p.unit for unit in ("Nm", "kg")) for p in effect.parameters]
    return ESTIMATES.t95 * CURRENT.known * np.array(is_force)


def _narrow(cell: ResidualCell, ids: np.ndarray) -> ResidualCell:
    """The cell with nothing but the columns of some parameters: the others cost more than all that is done here."""
    own, _ = parameter_indices(cell, ids)
    order = np.append(own, len(cell.ids))
    sums = {name: getattr(cell, name)[:, order[:, None], order] for name in ("test", "held", "plain")}
    return replace(cell, ids=cell.ids[own], matrix=cell.matrix[:, own], **sums)


def _settle(design: RegressionProblem, cells: list[ResidualCell], ids: np.ndarray, candidate: Candidate):
    """(effect, cells with its columns, half width of the shape's interval) where the likelihood is greatest."""
    effect = candidate.effect
    best, best_cells = effect, cells
    level = _likelihood(cells, ids, design)
    if effect.nonlinear.linear:
        trail: list[tuple[float, float]] = []  # log of shape and of the share of it that fits the data best
        for _ in range(ROUNDS):
            share = _value(best_cells, ids, design, candidate)
            if not ESTIMATES.shares[0] < share < ESTIMATES.shares[1] or abs(share - 1) < SETTLED_SHARE:
                break
            trail.append((np.log(best.nonlinear.value), np.log(share)))
            slope = -1.0
            if len(trail) > 1 and trail[-1][0] != trail[-2][0]:
                slope = (trail[-1][1] - trail[-2][1]) / (trail[-1][0] - trail[-2][0])
            step = -trail[-1][1] / min(slope, SLOPE)
            best = best.nonlinear.rebuild(
                best.nonlinear.value * float(np.exp(np.clip(step, -LONGEST_STEP, LONGEST_STEP)))
            )
            best_cells = replace_regressor(design, cells, candidate, best)
        return best, best_cells, 0.0
    step = FIRST_STEP
    trace = {effect.nonlinear.value: level}
    for _ in range(STEPS):
        value = best.nonlinear.value
        for other in (value * (1 - step), value * (1 + step)):
            trial = best.nonlinear.rebuild(other)
            changed = replace_regressor(design, cells, candidate, trial)
            trace[other] = _likelihood(changed, ids, design)
            if trace[other] > level:
                best, best_cells, level = trial, changed, trace[other]
        step *= NARROWING if best.nonlinear.value == value else 1.0
    return best, best_cells, _width(best.nonlinear.value, level, trace)


def _settle_all(design: RegressionProblem, cells: list[ResidualCell], ids: np.ndarray, candidate: Candidate):
    """`_settle` of the effect and of its rivals: all that the likeliest does not surely beat (Vuong 1989), the middle shape first."""
    settled = [_settle(design, cells, ids, candidate)]
    if not candidate.effect.nonlinear.rivals:
        return settled
    for rival in candidate.effect.nonlinear.rivals:
        effect = rival(settled[-1][0].nonlinear.value)  # near where that of the neighbour has settled
        changed = replace_regressor(design, cells, candidate, effect)
        settled.append(_settle(design, changed, ids, replace(candidate, effect=effect)))
    density = np.array([_block_likelihood(cells, ids, design) for _, cells, _ in settled])
    behind = density[density.sum(axis=1).argmax()] - density
    error = np.sqrt(behind.shape[1]) * behind.std(axis=1)
    as_likely = behind.sum(axis=1) <= np.maximum(ESTIMATES.interval_fall, ESTIMATES.t95 * error)
    chosen = sorted((one for one, is_so in zip(settled, as_likely) if is_so), key=lambda one: one[0].nonlinear.value)
    middle = len(chosen) // 2
    return [chosen[middle], *chosen[:middle], *chosen[middle + 1 :]]


def _block_likelihood(cells: list[ResidualCell], ids: np.ndarray, design: RegressionProblem) -> np.ndarray:
    """Log likelihood (m,) of each block at the fit to everything, nats."""
    whole, density = _whole(cells, ids, design), 0.0
    for cell, variance in zip(cells, whole.variance[:, 0]):
        columns, at = parameter_indices(cell, ids)
        squares = residual_sum_of_squares(sub_gram(cell.test, columns), whole.parameters[:, at])
        density = density - 0.5 * (cell.test_rows * np.log(variance) + squares / variance)
    return density


def _shift(
    design: RegressionProblem,
    cells: list[ResidualCell],
    ids: np.ndarray,
    candidate: Candidate,
    effect: EffectRegressor,
    width: float,
) -> np.ndarray:
    """By how much the parameters (p,) move while the shape moves over its half width.

    The intervals of `_interval` hold for one shape. Where a stroke and a stiffness wind up nearly the same torque,
    each is as uncertain as the other makes it.
    """
    value = effect.nonlinear.value
    ends = max(value - width, SMALLEST_SHAPE * value), value + width
    low, high = (
        _whole(replace_regressor(design, cells, candidate, effect.nonlinear.rebuild(end)), ids, design).parameters[0]
        for end in ends
    )
    return (high - low) * width / (ends[1] - ends[0])


def _widen_beside_curve(
    cells: list[ResidualCell], ids: np.ndarray, design: RegressionProblem, whole: np.ndarray, half: np.ndarray
) -> np.ndarray:
    """Half widths (p,) that do not depend on the rows about reversals, where no curve of speed holds.

    Only these rows distinguish a constant torque from friction that differs by direction: without them its interval is as wide as both
    allow.
    """
    without = _whole([c for c in cells if not c.at_reversal], ids, design)
    known = ESTIMATES.t95 * np.sqrt(np.diagonal(without.covariance[0]))
    return np.hypot(np.maximum(half, known), without.parameters[0] - whole)


def _width(value: float, level: float, trace: dict[float, float]) -> float:
    """Half width at which the likelihood has fallen by `interval_fall`, from a parabola through the points near it."""
    points = [(x - value, level - y) for x, y in trace.items() if 0 < level - y < ESTIMATES.parabola_fall]
    if not points:
        return ESTIMATES.unknown_width * abs(value)
    curvature = np.median([2 * fall / x**2 for x, fall in points if x])
    return float(min(np.sqrt(2 * ESTIMATES.interval_fall) / np.sqrt(max(curvature, 1e-30)), abs(value)))


def _value(cells: list[ResidualCell], ids: np.ndarray, design: RegressionProblem, candidate: Candidate) -> float:
    whole = _whole(cells, ids, design)
    return float(whole.parameters[0][np.flatnonzero(ids == candidate.ids[0])[0]])


def _whole(cells: list[ResidualCell], ids: np.ndarray, design: RegressionProblem):
    return fit_parameters(
        cells, [c.total[None] for c in cells], [c.test_rows.sum()[None] for c in cells], ids, design.parameters
    )


def _likelihood(cells: list[ResidualCell], ids: np.ndarray, design: RegressionProblem) -> float:
    """Log likelihood at the fit to everything, nats."""
    whole = _whole(cells, ids, design)
    return float(sum(-0.5 * c.test_rows.sum() * np.log(v[0]) for c, v in zip(cells, whole.variance)))


def replace_regressor(
    design: RegressionProblem, cells: list[ResidualCell], candidate: Candidate, effect: EffectRegressor
) -> list[ResidualCell]:
    """The cells with the columns of another nonlinear parameter of the candidate's effect, whitened as before."""
    stages, changed = design.stages, []
    for cell in cells:
        places = np.flatnonzero(np.isin(cell.ids, candidate.ids))
        columns = stages.columns(effect, cell.stage, cell.joint) if places.size else None
        if columns is None:
            changed.append(cell)
            continue
        matrix = cell.matrix.copy(order="K")
        matrix[:, places] = columns
        changed.append(
            make_cell(
                stages,
                cell.stage,
                cell.joint,
                cell.ids,
                matrix,
                design.blocks,
                design.parameters,
                cell.whiten,
                cell.at_reversal,
            )
        )
    return changed
