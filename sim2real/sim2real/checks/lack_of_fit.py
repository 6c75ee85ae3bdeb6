"""An omnibus test of lack of fit: does a flexible model without physical meaning predict what the chosen model leaves?

Where the flexible model (`inference.flexible`) predicts unseen
blocks clearly better than the chosen model, the catalogue has no explanation, however well its best effect fits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim2real.arm.rigid_body import drive_inertia
from sim2real.effects.evidence import Context
from sim2real.effects.regressor import Parameter
from sim2real.effects.stage import Stage
from sim2real.inference.fit import ParameterFit, predict_held_out_residual, score_held_out
from sim2real.inference.flexible import flexible_columns
from sim2real.inference.regression import RegressionProblem
from sim2real.inference.residual_cells import ResidualCell, make_cell
from sim2real.inference.residual_stages import ResidualStages
from sim2real.inference.search import ModelSearch, fits_by_joint
from sim2real.thresholds import THRESHOLDS

OMNIBUS = THRESHOLDS.omnibus


@dataclass(frozen=True, eq=False)
class LackOfFit:
    """What the omnibus test finds at one stage of one joint.

    gain: nats by which the flexible model predicts unseen blocks better, with its standard error over blocks.
    null, chosen, flexible: sums of squared held-out residuals over `rows` rows of the model without effects, of the
    chosen one, and of the chosen one with the flexible model. white: standard deviation of the noise, that is of the
    part of the residual without any memory (from third differences), and no more than the sensors have where they
    show it, or what an earlier recording leaves. outlying: mean squares of what lies further out than noise does, without effects and with the chosen
    model.
    """

    stage: Stage
    joint: int
    gain: float
    error: float
    null: float
    chosen: float
    flexible: float
    rows: int
    white: float
    outlying: tuple[float, float] = (0.0, 0.0)

    @property
    def excess(self) -> float:
        """Mean square of what the chosen model leaves, beyond white noise."""
        return max(self.chosen / self.rows - self.white**2, 0.0)

    @property
    def removed(self) -> float:
        """Share of the mean square beyond white noise that the chosen model removes."""
        reducible = self.null / self.rows - self.white**2
        return 1.0 if reducible <= 0 else float(np.clip(1 - self.excess / reducible, 0.0, 1.0))


def omnibus_test(search: ModelSearch, members: tuple[int, ...]) -> list[LackOfFit]:
    """Lack of fit of the model with these members, at every stage of torques of every joint with enough rows."""
    design, found = search.design, []
    fits = fits_by_joint(search, members)
    for cell in design.cells:
        if cell.at_reversal or cell.stage is Stage.TRANSMISSION or cell.used.sum() < OMNIBUS.blocks:
            continue
        found.append(_lack_of_fit(design, cell, *fits[cell.joint]))
    return found


def _lack_of_fit(design: RegressionProblem, cell: ResidualCell, ids: np.ndarray, fit: ParameterFit) -> LackOfFit:
    """Of one cell. The flexible model is fitted to residuals of blocks that the chosen model has not seen."""
    left = predict_held_out_residual(cell, ids, fit)
    gain, error, after = predict_from_columns(
        design, cell, left, flexible_columns(design.context, cell.stage, cell.joint)
    )
    rows = cell.rows
    return LackOfFit(
        cell.stage,
        cell.joint,
        gain,
        error,
        float(np.square(cell.residual[rows]).sum()),
        float(np.square(left[rows]).sum()),
        float(np.square(after[rows]).sum()),
        int(rows.sum()),
        _noise(design, cell, left),
        _outlying(cell.residual[rows], left[rows]),
    )


def predict_from_columns(
    design: RegressionProblem, cell: ResidualCell, left: np.ndarray, columns: np.ndarray
) -> tuple[float, float, np.ndarray]:
    """How well columns (n, count) predict what is `left` (n,) of a cell, each block from a fit to the others.

    Returns the gain in nats, its standard error over blocks, and the residual (n,) after it.
    """
    columns, left = design.stages.question_columns(cell.stage, cell.rows, columns, left)
    scale = np.sqrt(np.mean(columns[cell.rows] ** 2, axis=0)) + 1e-12
    spread = float(np.sqrt(np.mean(left[cell.rows] ** 2))) + 1e-12
    parameters = [Parameter("any", "", -1e9, 1e9, spread / s) for s in scale]
    ids = np.arange(len(scale))
    own = _Residual(design.stages, left, cell.rows)
    flexible = make_cell(
        own, cell.stage, cell.joint, ids, columns, design.blocks, parameters, at_reversal=cell.at_reversal
    )
    null, full = (score_held_out([flexible], used, parameters) for used in (ids[:0], ids))
    difference = full.density - null.density
    return (
        float(difference.sum()),
        float(np.sqrt(len(difference)) * difference.std(ddof=1)),
        predict_held_out_residual(flexible, ids, full.fit),
    )


def _outlying(before: np.ndarray, after: np.ndarray) -> tuple[float, float]:
    """Mean squares of the parts of two residuals (n,) that lie beyond `outlying` standard deviations of `after`.

    What happens now and then has no shape that a flexible model could learn, but noise never goes so far.
    """
    usual = 1.4826 * np.median(np.abs(after - np.median(after)))
    return tuple(float(np.mean(np.where(np.abs(r) > OMNIBUS.outlying * usual, r, 0.0) ** 2)) for r in (before, after))


def _noise(design: RegressionProblem, cell: ResidualCell, left: np.ndarray) -> float:
    """Standard deviation of the noise in what is `left` (n,) of a cell. Of two recordings of an arm, what the earlier one
    leaves of its dynamics is noise as well, coloured or not, for nothing had changed there."""
    rows = cell.rows
    white = min(float(np.std(np.diff(left[rows], 3)) / np.sqrt(20)), _sensors(design.context, cell))
    earlier = rows & ~design.context.is_later(design.stages.times(cell.stage)[0])
    if cell.stage is Stage.DYNAMICS and earlier.any():
        return max(white, float(np.sqrt(np.mean(np.square(left[earlier])))))
    return white


def _sensors(context: Context, cell: ResidualCell) -> float:
    """Largest standard deviation Nm that the sensors' noise can have in a residual.

    It is known for r2 of a recording without commands, and infinite elsewhere. A joint that shakes has no memory at
    the rate of the samples either, and is no noise.
    """
    if cell.stage is not Stage.DYNAMICS or context.drive is not None:
        return np.inf
    j = cell.joint
    inertia = drive_inertia(context.arm, np.median(context.samples.position, axis=0))[j]
    return float(np.hypot(context.samples.noise[j], inertia * context.samples.shaking[j]))


@dataclass(frozen=True, eq=False)
class _Residual:
    """The stages with another residual, and other rows that count."""

    stages: ResidualStages
    left: np.ndarray
    kept: np.ndarray

    def times(self, stage: Stage):
        return self.stages.times(stage)

    def residual(self, stage: Stage, joint: int) -> np.ndarray:
        return self.left

    def rows(self, stage: Stage, joint: int, at_reversal: bool) -> np.ndarray:
        return self.kept

    def project_out_reference(
        self,
        stage: Stage,
        joint: int,
        rows: np.ndarray,
        matrix: np.ndarray,
        residual: np.ndarray,
        at_reversal: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        return matrix, residual
