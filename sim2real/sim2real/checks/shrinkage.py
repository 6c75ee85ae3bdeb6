"""How far: the held-out gap before and after, summed over the stages, with the part that no model could remove."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim2real.checks.repeatability import measure_repeatability
from sim2real.effects.stage import Stage
from sim2real.inference.bootstrap import draw_counts
from sim2real.inference.fit import predict_held_out_residual
from sim2real.inference.search import ModelSearch, ScoredModel, fits_by_joint
from sim2real.recordings.signals import white_noise
from sim2real.thresholds import THRESHOLDS

SHRINKAGE = THRESHOLDS.shrinkage

REGIMES = ("standstill", "reversal", "slow", "fast", "accelerating")


@dataclass(frozen=True, eq=False)
class Gap:
    """The gap of a model.

    By joint (k,), Nm: root mean square over time, summed over the stages of torques, before (without effects) and
    after (with the model), and the floor; moved (k,): joints that were excited enough. before, after, floor: means
    over the joints that moved; shrink with its 95 % interval. nominal, residuals: by number of the cell, the held-out
    residual without effects and with the model. Both are without what any arm has (nuisances): no effect is credited
    with it, and no patch carries it.
    """

    before_joint: np.ndarray
    after_joint: np.ndarray
    floor_joint: np.ndarray
    is_floor_measured: np.ndarray
    moved: np.ndarray
    shrink: float
    shrink_interval: tuple[float, float]
    nominal: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]

    @property
    def before(self) -> float:
        """Mean of the joints, Nm."""
        return float(self.before_joint[self.moved].mean())

    @property
    def after(self) -> float:
        """Mean of the joints, Nm."""
        return float(self.after_joint[self.moved].mean())

    @property
    def floor(self) -> float:
        """Mean of the joints, Nm."""
        return float(self.floor_joint[self.moved].mean())

    def shrink_alone(self, search: ModelSearch, member: int) -> float:
        """Share by which one effect alone shrinks the gap of the joints that it shows in."""
        return _share(search, (), (member,))

    def energy_removed(self, search: ModelSearch, chosen: ScoredModel, member: int) -> float:
        """Mean square Nm^2, summed over joints and stages, that the model without this member leaves beyond the model."""
        less = tuple(m for m in chosen.members if m != member)
        return float(_squares(search, less).sum() - _squares(search, chosen.members).sum())


def measure_gap(search: ModelSearch, chosen: ScoredModel, seed: int) -> Gap:
    """The gap of the chosen model. Raises ValueError where no joint moves in enough blocks."""
    design = search.design
    cells, joints = design.cells, len(design.context.arm)
    nominal, after = _residuals(search, ()), _residuals(search, chosen.members)
    floor, is_measured = _floor(design, joints)
    before_block, after_block, rows = _by_block(cells, nominal, after, len(design.blocks))
    moved = np.array(
        [
            any(
                c.joint == j and c.stage is Stage.DYNAMICS and not c.at_reversal and c.used.sum() >= SHRINKAGE.blocks
                for c in cells
            )
            for j in range(joints)
        ]
    )
    if not moved.any():
        raise ValueError(f"expected a joint that moves in {SHRINKAGE.blocks} blocks of the recording, got none")
    every = np.ones((1, len(design.blocks)))
    old, new = (rms_by_joint(cells, part, rows, every, joints)[0] for part in (before_block, after_block))
    weights = draw_counts(len(design.blocks), SHRINKAGE.bootstraps, seed)
    olds, news = (rms_by_joint(cells, part, rows, weights, joints) for part in (before_block, after_block))
    shrink = 1 - new[moved].mean() / max(old[moved].mean(), 1e-12)
    draws = 1 - news[:, moved].mean(axis=1) / np.maximum(olds[:, moved].mean(axis=1), 1e-12)
    half = THRESHOLDS.estimates.t95 * draws.std()
    return Gap(
        old,
        new,
        np.minimum(floor, np.minimum(old, new)),
        is_measured,
        moved,
        float(shrink),
        (float(max(-1.0, shrink - half)), float(min(1.0, shrink + half))),
        tuple(nominal),
        tuple(after),
    )


def split_regimes(velocity: np.ndarray, acceleration: np.ndarray, reversing: np.ndarray) -> dict[str, np.ndarray]:
    """Masks (n, k): each sample of a joint is in exactly one regime. reversing (n, k) bool."""
    standing = (np.abs(velocity) <= SHRINKAGE.standing) & ~reversing
    masks, remaining = {}, np.ones_like(standing)
    for name, mask in (
        ("standstill", standing),
        ("reversal", reversing),
        ("accelerating", np.abs(acceleration) > SHRINKAGE.accelerating),
        ("fast", np.abs(velocity) > SHRINKAGE.fast),
    ):
        masks[name], remaining = remaining & mask, remaining & ~mask
    return {name: masks.get(name, remaining) for name in REGIMES}


def _residuals(search: ModelSearch, members: tuple[int, ...]) -> list[np.ndarray]:
    fits = fits_by_joint(search, members)
    return [predict_held_out_residual(cell, *fits[cell.joint]) for cell in search.design.cells]


def _counted(cell) -> bool:
    return cell.stage is not Stage.TRANSMISSION


def _squares(search: ModelSearch, members: tuple[int, ...]) -> np.ndarray:
    """Mean square (cells,) of the held-out residual of every cell; r3 is a twist, no torque, and weighed."""
    cells = search.design.cells
    total = []
    for cell, left in zip(cells, _residuals(search, members)):
        rows = cell.rows
        square = float(np.square(left[rows]).mean()) if rows.any() else 0.0
        total.append(square if _counted(cell) else square * SHRINKAGE.twist_weight)
    return np.array(total)


def _share(search: ModelSearch, fewer: tuple[int, ...], more: tuple[int, ...]) -> float:
    before, after = _squares(search, fewer), _squares(search, more)
    shows = np.array(
        [
            bool(np.isin(c.ids, np.concatenate([search.design.candidates[m].ids for m in more])).any())
            for c in search.design.cells
        ]
    )
    touched = {c.joint for c, s, b, a in zip(search.design.cells, shows, before, after) if s and a != b}
    mine = np.array([c.joint in touched for c in search.design.cells])
    if not mine.any() or before[mine].sum() <= 0:
        return 0.0
    return float(1 - np.sqrt(after[mine].sum() / before[mine].sum()))


def _by_block(cells, old, new, blocks: int):
    """Sums of squares (cells, blocks) before and after, and rows."""
    before, after, rows = (np.zeros((len(cells), blocks)) for _ in range(3))
    for n, cell in enumerate(cells):
        kept = cell.rows & (cell.block >= 0)
        block = cell.block[kept]
        for table, values in ((before, old[n]), (after, new[n])):
            table[n] = np.bincount(block, np.square(values[kept]), blocks)
        rows[n] = np.bincount(block, minlength=blocks)
    return before, after, rows


def rms_by_joint(cells, squares, rows, weights, joints: int) -> np.ndarray:
    """(draws, joints) Nm: root of the sum over stages of the mean square."""
    total = np.zeros((len(weights), joints))
    for joint in range(joints):
        for stage in (Stage.CONTROLLER, Stage.DRIVE, Stage.DYNAMICS):
            mine = [n for n, c in enumerate(cells) if c.joint == joint and c.stage is stage]
            if mine:
                count = np.maximum(sum(weights @ rows[n] for n in mine), 1)
                total[:, joint] += sum(weights @ squares[n] for n in mine) / count
    return np.sqrt(total)


def _floor(design, joints: int) -> tuple[np.ndarray, np.ndarray]:
    context = design.context
    residual = context.samples.torque - context.prediction.total
    floor, is_measured = measure_repeatability(context.samples, residual)
    total = floor**2
    if context.drive is not None:
        d = context.drive
        for values in (d.measured - d.commanded, d.commanded - d.law):
            total = total + white_noise(values) ** 2
    return np.sqrt(total), is_measured
