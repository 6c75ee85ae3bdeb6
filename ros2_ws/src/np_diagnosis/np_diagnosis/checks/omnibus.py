"""Is anything left? A flexible model of no physical meaning tries to predict what the chosen effects leave.

It has what a smooth unknown mechanism would need: harmonics of the joint's angle, alone and signed by the
direction of motion, powers of velocity and of torque, and what the other joints do. Where it predicts unseen
blocks clearly better than the catalogue, the catalogue has no explanation, however well its best effect fits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_diagnosis.arm.rigid import felt_inertia
from np_diagnosis.effects.base import Context, Parameter
from np_diagnosis.inference.cells import Cell, make_cell
from np_diagnosis.inference.design import Design
from np_diagnosis.inference.fit import score
from np_diagnosis.inference.residuals import Stages
from np_diagnosis.inference.search import Search, fits_of, held_out
from np_effects.stage import Stage

HARMONICS = 6
FAR = 5.0  # standard deviations, which one value in two million of normal noise passes


@dataclass(frozen=True, eq=False)
class Rest:
    """What a flexible model adds at one stage of one joint: gain nats and its standard error over blocks;
    energies: squared held-out residual of nothing, of the structure, of the structure with the model. white:
    standard deviation of noise: the part that has no memory at all, from third differences, and no more than
    the sensors have where they show it. outlying: mean square of what lies further out than noise does, of nothing
    and of the structure."""

    stage: Stage
    joint: int
    gain: float
    error: float
    nothing: float
    structure: float
    flexible: float
    rows: int
    white: float
    outlying: tuple[float, float] = (0.0, 0.0)

    @property
    def excess(self) -> float:
        """Mean square of what the structure leaves, beyond white noise."""
        return max(self.structure / self.rows - self.white**2, 0.0)

    @property
    def removed(self) -> float:
        """Share of what is no white noise that the structure takes away."""
        reducible = self.nothing / self.rows - self.white**2
        return 1.0 if reducible <= 0 else float(np.clip(1 - self.excess / reducible, 0.0, 1.0))


def examine(search: Search, members: tuple[int, ...]) -> list[Rest]:
    """Every stage of every joint with enough rows."""
    design, found = search.design, []
    fits = fits_of(search, members)
    for cell in design.cells:
        if cell.at_reversal or cell.stage is Stage.TRANSMISSION or cell.used.sum() < 4:
            continue
        found.append(_rest(design, cell, *fits[cell.joint]))
    return found


def _rest(design: Design, cell: Cell, ids: np.ndarray, fit) -> Rest:
    """The model is fitted to what the structure leaves of blocks that it has not seen."""
    left = held_out(cell, ids, fit)
    gain, error, after = predicted(design, cell, left, _flexible(design.context, cell))
    rows = cell.rows
    return Rest(
        cell.stage,
        cell.joint,
        gain,
        error,
        float(np.square(cell.residual[rows]).sum()),
        float(np.square(left[rows]).sum()),
        float(np.square(after[rows]).sum()),
        int(rows.sum()),
        min(float(np.std(np.diff(left[rows], 3)) / np.sqrt(20)), _sensors(design.context, cell)),
        _outlying(cell.residual[rows], left[rows]),
    )


def predicted(design: Design, cell: Cell, left: np.ndarray, columns: np.ndarray) -> tuple[float, float, np.ndarray]:
    """(gain nats, its standard error over blocks, residual (n,) after it) of columns (n, count) that are fitted
    to what is `left` (n,) of a cell, each block predicted from the others."""
    scale = np.sqrt(np.mean(columns[cell.rows] ** 2, axis=0)) + 1e-12
    spread = float(np.sqrt(np.mean(left[cell.rows] ** 2))) + 1e-12
    parameters = [Parameter("any", "", -1e9, 1e9, spread / s) for s in scale]
    ids = np.arange(len(scale))
    own = _Residual(design.stages, left, cell.rows)
    flexible = make_cell(
        own, cell.stage, cell.joint, ids, columns, design.blocks, parameters, at_reversal=cell.at_reversal
    )
    nothing, full = (score([flexible], used, parameters) for used in (ids[:0], ids))
    difference = full.density - nothing.density
    return (
        float(difference.sum()),
        float(np.sqrt(len(difference)) * difference.std(ddof=1)),
        held_out(flexible, ids, full.fit),
    )


def _outlying(before: np.ndarray, after: np.ndarray) -> tuple[float, float]:
    """Mean square of residuals (n,) beyond `FAR` standard deviations of what is usual after the structure. What
    happens now and then has no shape that a flexible model could learn; noise never goes so far."""
    usual = 1.4826 * np.median(np.abs(after - np.median(after)))
    return tuple(float(np.mean(np.where(np.abs(r) > FAR * usual, r, 0.0) ** 2)) for r in (before, after))


def _sensors(context: Context, cell: Cell) -> float:
    """Standard deviation Nm that the noise of the sensors leaves in r2 of a recording without commands: what a
    joint shakes with is no noise, though at the samples' rate it has no memory either. Else no bound."""
    if cell.stage is not Stage.DYNAMICS or context.drive is not None:
        return np.inf
    j = cell.joint
    inertia = felt_inertia(context.arm, np.median(context.samples.position, axis=0))[j]
    return float(np.hypot(context.samples.noise[j], inertia * context.samples.shaking[j]))


@dataclass(frozen=True, eq=False)
class _Residual:
    """A stage with another residual."""

    stages: Stages
    left: np.ndarray
    kept: np.ndarray

    def times(self, stage: Stage):
        return self.stages.times(stage)

    def residual(self, stage: Stage, joint: int) -> np.ndarray:
        return self.left

    def rows(self, stage: Stage, joint: int, at_reversal: bool) -> np.ndarray:
        return self.kept


def _flexible(context: Context, cell: Cell) -> np.ndarray:
    """Columns (n, count)."""
    j = cell.joint
    if cell.stage is Stage.DYNAMICS:
        s, p = context.samples, context.prediction
        q, v, direction = s.position[:, j], s.velocity[:, j], p.direction[:, j]
        others = [s.velocity[:, k] for k in range(len(context.arm)) if k != j]
        others += [s.acceleration[:, k] for k in range(len(context.arm)) if k != j]
        torque = s.torque[:, j]
    else:
        d = context.drive
        v, torque = d.velocity[:, j], d.commanded[:, j]
        direction = np.tanh(v / 0.01)
        others = [np.gradient(d.commanded[:, j])]
        q = np.zeros_like(v)
    columns = [np.ones_like(v), direction, v, v * np.abs(v), v**3, np.abs(v), direction * np.abs(torque), *others]
    columns += [torque, np.abs(torque), torque * np.abs(torque), torque**3]
    if cell.stage is Stage.DYNAMICS:
        for k in range(1, HARMONICS + 1):
            columns += [np.sin(k * q), np.cos(k * q), direction * np.sin(k * q), direction * np.cos(k * q)]
    return np.array(columns).T
