"""Torque rate limit: how fast the drive follows at most, the gravity that it compensates included.

Within a period it ramps: a period's torque, measured and acting, is its mean.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from np_common.rotations import namespace
from sim2real.effects import evidence
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import DriveFunction, DriveHook, DriveSlot, HookContext, infinite_where_zero
from sim2real.effects.limits import GRAVITY_APART, DriveLimit, candidate_levels, limit_column
from sim2real.effects.regressor import WHOLE, EffectRegressor, NonlinearParameter, stack
from sim2real.effects.stage import Stage

LIMIT = Quantity("limit", "Nm/s", 0.0, 1e5)
RAMP_KNOWN = 0.02  # of a rate: within a period a drive may ramp, or step at its end


def limit_rate(d: evidence.Drive, values: np.ndarray, rate: float, measured: np.ndarray | None = None) -> np.ndarray:
    """values (n,) followed at no more than `rate` a second, anew in each stretch: from what was given (n,) at its beginning,
    where that is further away than a period's step (a drive that was behind when the recording began), else from the values."""
    step, limited = rate * d.period, values.copy()
    if measured is not None:
        behind = d.starts[np.abs(measured[d.starts] - values[d.starts]) > step]
        limited[behind] = measured[behind]
    jumps = np.abs(np.diff(limited, prepend=limited[:1])) > step
    jumps[d.starts] = False
    ends = np.append(d.starts[1:], len(values))
    follows = 0  # row up to which the values have been followed
    for first in np.flatnonzero(jumps).tolist():
        if first < follows:
            continue
        end = int(ends[np.searchsorted(ends, first, side="right")])
        last = limited[first - 1]
        for i in range(first, end):
            value = values[i]
            last = min(max(value, last - step), last + step)
            limited[i] = last
            follows = i + 1
            if last == value:
                break
    return limited


def ramp_torque(d: evidence.Drive, values: np.ndarray, rate: float, measured: np.ndarray | None = None) -> np.ndarray:
    """Mean over each period (n,) of what follows values (n,) at no more than `rate` a second, as `limit_rate`."""
    ends = limit_rate(d, values, rate, measured)
    rise = np.diff(ends, prepend=ends[:1])
    rise[d.starts] = 0.0
    return ends - _ramp_deficit(rise, rate * d.period)


def _ramp_deficit(rise: np.ndarray, step: np.ndarray | float) -> np.ndarray:
    """By how much the mean of a period is less than its end, of a ramp by `rise` that could have risen by `step`."""
    return 0.5 * rise * abs(rise) / step


def _regressor(limit: float, joint: int, gravity_apart: bool) -> EffectRegressor:
    return EffectRegressor(
        "torque_rate_limit",
        (WHOLE,),
        {Stage.DRIVE: lambda c, j: stack(limit_column(c.drive, j, ramp_torque, limit, gravity_apart))},
        "largest rate of the drive",
        f"{limit:.3g} Nm/s{', gravity apart' if gravity_apart else ''}",
        NonlinearParameter(
            "limit",
            "Nm/s",
            limit,
            partial(_regressor, joint=joint, gravity_apart=gravity_apart),
            background=RAMP_KNOWN * limit,
        ),
        only_joint=joint,
        constants={GRAVITY_APART.name: 1.0} if gravity_apart else {},
    )


def _levels(context: Context, joint: int, gravity_apart: bool, rows: np.ndarray) -> list[float]:
    """Limits Nm/s to try for rows (n,) bool of the drive."""
    d = context.drive
    gravity = 0.0 if gravity_apart else d.gravity[:, joint]
    within = np.ones(len(d.time), bool)
    within[d.starts] = False
    commanded, measured = (
        np.diff(torque[:, joint] + gravity, prepend=0.0) / d.period for torque in (d.arrived, d.measured)
    )
    return candidate_levels(commanded[within], measured[within & rows])


def _limit_rate(values: HookContext) -> DriveFunction:
    step, last = infinite_where_zero(values("limit")) * values.period, None

    def drive(torque: np.ndarray) -> np.ndarray:
        nonlocal last
        begin = torque if last is None else last
        last = namespace(torque).clip(torque, begin - step, begin + step)
        return last - _ramp_deficit(last - begin, step)

    return drive


_LIMIT = DriveLimit(ramp_torque, _levels, _regressor)

EFFECT = Effect(
    "torque_rate_limit",
    EffectTarget.JOINT,
    (LIMIT, GRAVITY_APART),
    _LIMIT.regressors,
    DetectionLimit("share of the suite's peak", (0.06,) * 7, (1, 2, 3, 4, 5, 6, 7), largest=6),
    drive=DriveHook(DriveSlot.RATE, _limit_rate, of_total=True),
    reference_regressors=_LIMIT.reference_regressors,
    sentence_template="the drive of {at} changes its torque by no more than {limit:Nm/s}",
)
