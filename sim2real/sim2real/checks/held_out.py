"""Motion that neither fit nor choice of effects has seen: how far the model and each of its effects predict it better.

Short windows of each recording are laid aside before anything is fitted. Torques there are predicted by the equations of
motion, with the parameters of the rest; what a simulator makes of the same windows is `simulation.patch_trial`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.checks.shrinkage import rms_by_joint
from sim2real.inference.bootstrap import draw_counts
from sim2real.inference.fit import fit_parameters, parameter_indices
from sim2real.inference.residual_cells import ResidualCell
from sim2real.inference.search import ModelSearch, ScoredModel
from sim2real.recordings.signals import Log
from sim2real.thresholds import THRESHOLDS

HELD_OUT = THRESHOLDS.held_out


@dataclass(frozen=True, eq=False)
class EffectTrial:
    """What one effect does on held-out motion, beside all others of the model."""

    reduction: float
    """Share of the squared residual of its joints that goes with the effect."""
    interval: tuple[float, float]
    """95 % interval of the reduction, over windows."""
    is_shown: bool
    """Whether the held-out motion excites the effect, so that it can be judged."""

    @property
    def helps(self) -> bool:
        """Whether the effect is shown to help, or could not be judged."""
        return not self.is_shown or self.interval[0] > 0


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The residual torque on held-out motion without effects and with the model, Nm, RMS."""

    before: float
    """Mean over the joints that move."""
    after: float
    """Mean over the joints that move."""
    reduction: float
    """1 - after / before."""
    interval: tuple[float, float]
    """95 % interval of the reduction, over windows."""
    before_joint: np.ndarray
    """(k,)"""
    after_joint: np.ndarray
    """(k,)"""
    windows: int
    """Number of windows laid aside."""
    effects: dict[int, EffectTrial]
    """Of each effect that was chosen, by the number of its candidate, those that were dropped included."""


def lay_aside(logs: Sequence[Log], reference: int = 0) -> tuple[tuple[int, float, float], ...]:
    """Windows (number of the log, begin s, end s), evenly spread over each log.

    None where all logs are too short together, or the `reference` first ones, or the others.
    """
    parts = (logs[:reference], logs[reference:])
    if any(part and sum(log.duration for log in part) < HELD_OUT.shortest for part in parts):
        return ()
    return tuple(
        (number, float(begin), float(begin + HELD_OUT.window))
        for number, log in enumerate(logs)
        for begin in np.arange(0.5 * HELD_OUT.every, log.duration - HELD_OUT.window, HELD_OUT.every)
    )


def keep_what_helps(search: ModelSearch, chosen: ScoredModel, seed: int) -> tuple[ScoredModel, HeldOut | None]:
    """(the model without the effects that do not help on held-out motion, what was found there); None without windows.

    The worst effect goes first, and the others are tried again without it.
    """
    if not search.design.context.laid_aside:
        return chosen, None
    trials: dict[int, EffectTrial] = {}
    while True:
        fitted = _fitted_values(search, chosen.members)
        trials |= {m: _try_effect(search, chosen, fitted, m, seed) for m in chosen.members}
        useless = [m for m in chosen.members if not trials[m].helps]
        if not useless:
            return chosen, _measure(search, fitted, trials, seed)
        worst = min(useless, key=lambda m: trials[m].reduction)
        chosen = search.model(tuple(m for m in chosen.members if m != worst))


def _try_effect(search: ModelSearch, chosen: ScoredModel, full: np.ndarray, member: int, seed: int) -> EffectTrial:
    """The model, whose fitted values are `full` (p,), and the same fitted without one of its effects, on held-out motion."""
    ids = search.design.candidates[member].ids
    less = _fitted_values(search, tuple(m for m in chosen.members if m != member))
    count = len(search.design.context.laid_aside)
    before, after, shown = np.zeros(count), np.zeros(count), np.zeros(2)
    for cell in search.design.cells:
        columns, at = parameter_indices(cell, ids)
        if not len(columns) or not cell.rows.any():
            continue
        held, window = _held_out_rows(search, cell)
        with_it, without = (_residual(cell, values) for values in (full, less))
        variance = max(float(np.mean(with_it[cell.rows] ** 2)), 1e-24)
        own = cell.matrix[:, columns] @ full[ids[at]]
        shown += [np.square(own[rows]).sum() / variance for rows in (held, cell.rows)]
        before += np.bincount(window, np.square(without[held]) / variance, count)
        after += np.bincount(window, np.square(with_it[held]) / variance, count)
    drawn = draw_counts(count, HELD_OUT.bootstraps, seed)
    shares = 1 - (drawn @ after) / np.maximum(drawn @ before, 1e-24)
    low, high = np.quantile(shares, (0.025, 0.975))
    reduction = float(1 - after.sum() / max(before.sum(), 1e-24))
    return EffectTrial(reduction, (float(low), float(high)), bool(shown[0] > HELD_OUT.shown * shown[1]))


def _measure(search: ModelSearch, fitted: np.ndarray, trials: dict[int, EffectTrial], seed: int) -> HeldOut:
    cells, joints = search.design.cells, len(search.design.context.arm)
    count = len(search.design.context.laid_aside)
    before, after, rows = (np.zeros((len(cells), count)) for _ in range(3))
    for table, values in ((before, _fitted_values(search, ())), (after, fitted)):
        for n, cell in enumerate(cells):
            held, window = _held_out_rows(search, cell)
            table[n] = np.bincount(window, np.square(_residual(cell, values)[held]), count)
            rows[n] = np.bincount(window, minlength=count)
    every = np.ones((1, count))
    old, new = (rms_by_joint(cells, squares, rows, every, joints)[0] for squares in (before, after))
    drawn = draw_counts(count, HELD_OUT.bootstraps, seed)
    olds, news = (rms_by_joint(cells, squares, rows, drawn, joints).mean(axis=1) for squares in (before, after))
    low, high = np.quantile(1 - news / np.maximum(olds, 1e-12), (0.025, 0.975))
    reduction = float(1 - new.mean() / max(old.mean(), 1e-12))
    return HeldOut(float(old.mean()), float(new.mean()), reduction, (float(low), float(high)), old, new, count, trials)


def _held_out_rows(search: ModelSearch, cell: ResidualCell) -> tuple[np.ndarray, np.ndarray]:
    """(rows (n,) bool of a cell that are held out, the window (m,) that each of these is in)."""
    stages = search.design.stages
    window, later = stages.window_of(cell.stage), search.design.context.is_later(stages.times(cell.stage)[0])
    held = stages.can_count(cell.stage, cell.joint, cell.at_reversal) & (window >= 0) & later
    return held, window[held]


def _fitted_values(search: ModelSearch, members: tuple[int, ...]) -> np.ndarray:
    """Values (p,) of all parameters by id in the model with these members, fitted to all that is not held out; 0 of others."""
    design = search.design
    found = np.zeros(len(design.parameters))
    for joints, inside in search.groups(tuple(sorted(members))):
        ids = search.ids(joints, inside)
        cells = [cell for j in joints for cell in design.cells_of(j)]
        grams, rows = [c.total[None] for c in cells], [c.test_rows.sum()[None] for c in cells]
        found[ids] = fit_parameters(cells, grams, rows, ids, design.parameters).parameters[0]
    return found


def _residual(cell: ResidualCell, values: np.ndarray) -> np.ndarray:
    """What values (p,) of all parameters leave of the residual (n,) of a cell."""
    return cell.residual - cell.matrix @ values[cell.ids]
