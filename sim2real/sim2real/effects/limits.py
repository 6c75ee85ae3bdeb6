"""Limits of a drive act on all that it gives, the gravity that it compensates included; in some on the command alone.

The recording decides which of the two, joint by joint, before the limit is fitted: whatever is limited, one of the readings
leaves less of what was measured at every level.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.effects.effect import Quantity
from sim2real.effects.evidence import Context, Drive
from sim2real.effects.regressor import EffectRegressor

GRAVITY_APART = Quantity("gravity_apart", "1", 0.0, 1.0)  # 1: the limit is of the command, without gravity
LEVELS = tuple(0.95 * 0.88**n for n in range(8))  # of the largest command
OFTEN = 99.8  # per cent of the periods in which a drive at its limit gives no more
REACHED = (0.97, 1.0)  # of the largest given: a drive at its limit is there again and again
ACTS = 0.05  # of the squares between command and measurement that a limit must explain for its reading to matter
STEPS = (0.06, 0.03, 0.015, 0.008, 0.004)  # of a limit, by which it is looked for between two levels
FINE = (*STEPS, 0.002, 0.001, 5e-4, 2e-4, 1e-4)  # likewise, where what the limit takes is taken out
ALWAYS = 0.5  # of the squares in the rows in which a limit acts that one which was there leaves at most
LimitFunction = Callable[[Drive, np.ndarray, float, np.ndarray], np.ndarray]
"""What a limit leaves of commanded torques (n,) Nm, of which (n,) Nm were measured."""


@dataclass(frozen=True)
class DriveLimit:
    """A limit that the drive of a joint may have, as recordings show it."""

    limit_torque: LimitFunction
    """What the limit leaves of torques."""
    levels: Callable[[Context, int, bool, np.ndarray], list[float]]
    """(context, joint, whether gravity is apart, rows (n,) bool of the drive) -> limits to try."""
    regressor: Callable[[float, int, bool], EffectRegressor]
    """(limit, joint, whether gravity is apart) -> regressor."""

    def regressors(self, context: Context) -> list[EffectRegressor]:
        """Every level of each joint, in the reading that its drive receives."""
        if context.drive is None:
            return []
        found, later = [], context.is_later(context.drive.trajectory)
        drive = context.drive.only(later)
        for j in range(len(context.arm)):
            tried = self._candidate_levels(context, j, later)
            gravity_apart = excludes_gravity(drive, j, self.limit_torque, tried)
            found += [self.regressor(level, j, gravity_apart) for level in tried[gravity_apart]]
        return found

    def reference_regressors(self, context: Context) -> list[EffectRegressor]:
        """The limits that the drives had in the recordings of the arm as it was."""
        if context.drive is None:
            return []
        found, earlier = [], ~context.is_later(context.drive.trajectory)
        drive = context.drive.only(earlier)
        for j in range(len(context.arm)):
            shown = find_reference_limit(drive, j, self.limit_torque, self._candidate_levels(context, j, earlier))
            found += [self.regressor(shown[0], j, shown[1])] if shown else []
        return found

    def _candidate_levels(self, context: Context, joint: int, rows: np.ndarray) -> dict[bool, list[float]]:
        return {gravity_apart: self.levels(context, joint, gravity_apart, rows) for gravity_apart in (False, True)}


def limit_column(d: Drive, joint: int, limit_torque: LimitFunction, limit: float, gravity_apart: bool) -> np.ndarray:
    """Change (n,) Nm of a joint's torque by a limit."""
    gravity = 0.0 if gravity_apart else d.gravity[:, joint]
    total = d.arrived[:, joint] + gravity
    return limit_torque(d, total, limit, d.measured[:, joint] + gravity) - total


def candidate_levels(commanded: np.ndarray, measured: np.ndarray) -> list[float]:
    """Limits to try: shares of the largest commanded torque (n,), and about the largest measured torque (m,) that is reached again and again.
    A loop around a low limit oscillates, and commands many times what it gets."""
    often = float(np.percentile(np.abs(measured), OFTEN))
    return [*(level * float(np.abs(commanded).max()) for level in LEVELS), *(share * often for share in REACHED)]


def excludes_gravity(d: Drive, joint: int, limit_torque: LimitFunction, levels: dict[bool, Sequence[float]]) -> bool:
    """Whether gravity apart is the reading under which the best limit leaves less of what was measured.

    levels: where to begin, by reading. Between two of them the limit is looked for: how near one lies by chance is no evidence.
    """
    left = _make_squares_left(d, joint, limit_torque)
    best = _best_levels(left, levels)
    if min(best.values())[0] > (1 - ACTS) * left(np.inf, False):
        return False  # nothing is limited
    best = {gravity_apart: _refine_limit(left, found, gravity_apart, STEPS) for gravity_apart, found in best.items()}
    return best[True] < best[False]


def find_reference_limit(
    d: Drive, joint: int, limit_torque: LimitFunction, levels: dict[bool, Sequence[float]]
) -> tuple[float, bool] | None:
    """The limit that a joint's drive had, and whether it is of the command without gravity; None where nothing was limited.

    Whether it was there is tested on the rows in which the limit would act, which may be few: in those it must leave
    less than half of the squares that there are. levels: where to begin, by reading.
    """
    left = _make_squares_left(d, joint, limit_torque)
    best = _best_levels(left, levels)
    if min(best.values())[0] >= left(np.inf, False):
        return None  # a limit above the true one would explain a part of it
    (_, limit), gravity_apart = min(
        (_refine_limit(left, found, gravity_apart, FINE), gravity_apart) for gravity_apart, found in best.items()
    )
    column = limit_column(d, joint, limit_torque, limit, gravity_apart)
    acts = column != 0
    residual = (d.measured - d.arrived)[acts, joint]
    is_there = np.square(residual - column[acts]).sum() < ALWAYS * np.square(residual).sum()
    return (limit, gravity_apart) if is_there else None


SquaresLeft = Callable[[float, bool], float]
"""Squares Nm^2 of what was measured that a limit leaves, in one of the readings."""


def _make_squares_left(d: Drive, joint: int, limit_torque: LimitFunction) -> SquaresLeft:
    residual = d.measured[:, joint] - d.arrived[:, joint]

    def left(limit: float, gravity_apart: bool) -> float:
        change = 0.0 if np.isinf(limit) else limit_column(d, joint, limit_torque, limit, gravity_apart)
        return float(np.square(residual - change).sum())

    return left


def _best_levels(left: SquaresLeft, levels: dict[bool, Sequence[float]]) -> dict[bool, tuple[float, float]]:
    """(squares, limit) of the best of some limits, by reading."""
    return {
        gravity_apart: min((left(level, gravity_apart), level) for level in levels[gravity_apart])
        for gravity_apart in (False, True)
    }


def _refine_limit(
    left: SquaresLeft, found: tuple[float, float], gravity_apart: bool, steps: Sequence[float]
) -> tuple[float, float]:
    """(squares, limit) of the best limit about one that was found, looked for in smaller and smaller steps."""
    for step in steps:
        found = min([found, *((left(found[1] * x, gravity_apart), found[1] * x) for x in (1 - step, 1 + step))])
    return found
