"""Residuals, their times and rows, and the columns of effects, stage by stage of a recording."""

from __future__ import annotations

import numpy as np

from sim2real.arm.nominal_prediction import is_sliding
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.evidence import Context
from sim2real.effects.registry import make_reference_regressors, make_regressors
from sim2real.effects.regressor import EffectRegressor
from sim2real.effects.stage import Stage
from sim2real.inference import nuisances
from sim2real.inference.flexible import flexible_columns
from sim2real.inference.projection import hstack_contiguous, orthonormal_basis, project_out
from sim2real.thresholds import THRESHOLDS

ROWS = THRESHOLDS.rows
HINTS = THRESHOLDS.hints
# Effects whose columns are made of the residual that they explain.
LOSS, HYSTERESIS = "packet_loss", "transmission_hysteresis"


class ResidualStages:
    """Residuals, times and rows of each stage that this recording has."""

    def __init__(self, context: Context):
        self.context = context
        self.regressors = make_regressors(context)
        self._before = make_reference_regressors(context) if context.reference else []
        self._common: dict[tuple[Stage, int, bool], np.ndarray] = {}  # `orthonormal_basis` of each cell
        # Of the last joint requested: columns of effects by stage, and of what all recordings may have in common.
        self._kept: tuple[int, dict[tuple[int, Stage], tuple[EffectRegressor, np.ndarray]]] = (-1, {})
        self._alike_of: tuple[tuple[Stage, int], tuple[np.ndarray, np.ndarray]] | None = None
        self._projected: dict[tuple[int, int], tuple[EffectRegressor, np.ndarray]] = {}
        self.stages = [Stage.DYNAMICS]
        self._windows: dict[Stage, np.ndarray] = {}
        self._slides = np.column_stack([is_sliding(context.samples, j) for j in range(len(context.arm))])
        if context.drive is not None:
            self.stages += [Stage.CONTROLLER, Stage.DRIVE] if context.drive.is_replayed else [Stage.DRIVE]
            self._is_smooth = _smooth(context)
            drive = context.drive
            self._projector = context.samples.projector(drive.trajectory, drive.time + drive.period / 2)
        if context.transmission is not None:
            self.stages.append(Stage.TRANSMISSION)

    def times(self, stage: Stage) -> tuple[np.ndarray, np.ndarray]:
        """(trajectory (n,), time (n,)) of the rows."""
        c = self.context
        source = {Stage.DYNAMICS: c.samples, Stage.TRANSMISSION: c.transmission}.get(stage, c.drive)
        return source.trajectory, source.time

    def residual(self, stage: Stage, joint: int) -> np.ndarray:
        """Residual (n,)."""
        c = self.context
        if stage is Stage.DYNAMICS:
            return c.samples.torque[:, joint] - c.prediction.total[:, joint]
        if stage is Stage.TRANSMISSION:
            return c.transmission.twist[:, joint]
        if stage is Stage.CONTROLLER:
            return c.drive.commanded[:, joint] - c.drive.law[:, joint]
        return c.drive.measured[:, joint] - c.drive.commanded[:, joint]

    def columns(self, effect: EffectRegressor, stage: Stage, joint: int) -> np.ndarray | None:
        """Columns (n, parameters) of an effect at a stage of a joint, None where it does not show: in the recordings in
        which effects may show, zero in those of the arm as it was."""
        return self.mask_reference(stage, self._everywhere(effect, stage, joint))

    def question_columns(
        self, stage: Stage, rows: np.ndarray, columns: np.ndarray, left: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Columns (n, c) of a further question, and the residual (n,) to test it on: of the change only, where there is one."""
        if not self.context.reference:
            return columns, left
        both = project_out(
            orthonormal_basis(columns, rows),
            rows,
            hstack_contiguous([self.mask_reference(stage, columns), left[:, None]]),
        )
        return both[:, :-1], both[:, -1]

    def mask_reference(self, stage: Stage, columns: np.ndarray | None) -> np.ndarray | None:
        """Columns (n, c) of a stage, zero in the recordings of the arm as it was."""
        if columns is None or not self.context.reference:
            return columns
        return columns * self.context.is_later(self.times(stage)[0])[:, None]

    def project_out_reference(
        self,
        stage: Stage,
        joint: int,
        rows: np.ndarray,
        matrix: np.ndarray,
        residual: np.ndarray,
        at_reversal: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Columns (n, p) and residual (n,) of a cell without what its recordings have in common, by a fit to its rows; as
        they are without a reference."""
        if not self.context.reference:
            return matrix, residual
        cell = stage, joint, at_reversal
        if cell not in self._common:  # a shape that is being settled needs it again and again
            self._common[cell] = orthonormal_basis(self._alike(stage, joint), rows)
        known, common = np.isfinite(residual), self._common[cell]
        left = project_out(common, rows, np.where(known, residual, 0.0)[:, None])[:, 0]
        return project_out(common, rows, matrix), np.where(known, left, np.nan)

    def _alike(self, stage: Stage, joint: int) -> np.ndarray:
        """Columns (n, s) of all that both recordings of a cell may have in common."""
        if self._alike_of is None or self._alike_of[0] != (stage, joint):  # rows about reversals have the same
            self._alike_of = (stage, joint), self._said_of_both(stage, joint)
        straight, wound = self._alike_of[1]
        if not wound.shape[1]:
            return straight
        # Columns of a gear that winds nothing up are all alike, and rule out no change: they are of both recordings only
        # where the earlier one shows the same.
        bent = hstack_contiguous([straight, wound])
        earlier = self.rows(stage, joint) & ~self.context.is_later(self.times(stage)[0])
        twist = np.where(earlier, self.residual(stage, joint), 0.0)[:, None]
        left, less = (
            np.sum(project_out(orthonormal_basis(c, earlier), earlier, twist)[earlier] ** 2) for c in (straight, bent)
        )
        return bent if less < (1 - HINTS.always_wound) * left else straight

    def _said_of_both(self, stage: Stage, joint: int) -> tuple[np.ndarray, np.ndarray]:
        """Columns of `_alike`: those of a gear that winds up (n, w) apart from all others (n, s).

        A limit that the drive had before has a column of its own: between two limits of a grid the nearest one leaves
        what a new limit would explain. It is known by the torque measured, and so may be taken out of r2 as well.
        """
        own = [
            nuisances.nuisance_columns(self.context, stage, joint),
            flexible_columns(self.context, stage, joint, expected=True),
        ]
        wound = [np.zeros((len(own[0]), 0))]
        for effect in self.regressors:
            is_compared = effect.id != LOSS and ARM_EFFECTS[effect.id].reference_regressors is None
            if effect.only_joint in (None, joint) and stage in effect.columns and is_compared:
                (wound if effect.id == HYSTERESIS else own).append(self._own(effect, stage, joint))
        shown = [self._everywhere(effect, stage, joint) for effect in self._before if effect.only_joint == joint]
        own += [columns for columns in shown if columns is not None]
        return hstack_contiguous(own), hstack_contiguous(wound)

    def _everywhere(self, effect: EffectRegressor, stage: Stage, joint: int) -> np.ndarray | None:
        """Columns (n, parameters) of an effect in all recordings.

        With commands, r2 is taken from the commanded torque, so that the noise of the torque sensor is in r1 alone.
        What the drive makes of a command is then missing from r2, whatever the sensor measures.
        """
        if stage is not Stage.DYNAMICS or self.context.drive is None or Stage.DRIVE not in effect.columns:
            return self._own(effect, stage, joint) if stage in effect.columns else None
        if ARM_EFFECTS[effect.id].module == "sensing":
            return None
        key = (id(effect), joint)
        if key not in self._projected:
            values = self._own(effect, Stage.DRIVE, joint)
            projected = -np.column_stack([self._projector @ column for column in values.T])
            self._projected[key] = effect, projected  # kept too, lest another effect gets its id
        return self._projected[key][1]

    def _own(self, effect: EffectRegressor, stage: Stage, joint: int) -> np.ndarray:
        """Columns (n, parameters) that an effect itself has at a stage, kept while this joint is requested."""
        if self._kept[0] != joint:
            self._kept = joint, {}
        kept, key = self._kept[1], (id(effect), stage)
        if key not in kept:
            kept[key] = effect, effect.columns[stage](self.context, joint)
        return kept[key][1]

    def window_of(self, stage: Stage) -> np.ndarray:
        """Number (n,) of the window laid aside that each row lies in; -1 where in none."""
        if stage not in self._windows:
            self._windows[stage] = self.context.window_of(*self.times(stage))
        return self._windows[stage]

    def rows(self, stage: Stage, joint: int, at_reversal: bool = False) -> np.ndarray:
        """Rows (n,) bool that count: those that `can_count` outside of the windows laid aside."""
        return self.can_count(stage, joint, at_reversal) & (self.window_of(stage) < 0)

    def can_count(self, stage: Stage, joint: int, at_reversal: bool = False) -> np.ndarray:
        """Rows (n,) bool that are evidence on the stage.

        At the stage of the dynamics those are either the rows in which the joint slides in one direction, or
        those about its reversals, where friction behaves differently. A joint that stands is held by friction
        of any size up to its level, so that its torque does not depend on the motion: such rows never count, nor do those of a
        joint whose torque is unknown.
        """
        c = self.context
        if stage is Stage.DYNAMICS and not c.has_torque[joint]:
            return np.zeros(len(c.samples), bool)
        if stage is Stage.DYNAMICS and not at_reversal:
            return self._slides[:, joint]
        if stage is Stage.DYNAMICS:
            return (np.abs(c.samples.velocity[:, joint]) > ROWS.slowest) & ~self._slides[:, joint]
        if stage is Stage.TRANSMISSION:
            return np.isfinite(c.transmission.twist[:, joint])
        if stage is Stage.CONTROLLER:
            return self._is_smooth & ~c.drive.guarded[:, joint]
        return np.ones(len(c.drive.time), bool) if c.set_aside is None else ~c.set_aside


def _smooth(context: Context) -> np.ndarray:
    """Rows (n,) of the drive at which the target's acceleration, which was fed forward, is known: the velocity
    of the target has no kink there."""
    d = context.drive
    kinked = np.zeros(len(d.time), bool)
    for number, log in enumerate(context.logs):
        c = log.commands
        if c is None:
            continue
        bend = np.diff(c.target_velocity, 2, axis=0) / d.period
        around = 0.5 * (bend[:-4] + bend[4:])
        kink = np.abs(bend[2:-2] - around).max(axis=1) > ROWS.kink
        times = log.time[c.rows][3:-3][kink]
        rows = np.flatnonzero(d.trajectory == number)
        kinked[rows] = np.isin(np.round(d.time[rows] / d.period), np.round(times / d.period))
    edges = np.concatenate([[0], d.starts, [len(d.time)]])
    for start in edges:
        kinked[max(0, start - ROWS.kink_margin) : start + ROWS.kink_margin] = True
    return ~kinked
