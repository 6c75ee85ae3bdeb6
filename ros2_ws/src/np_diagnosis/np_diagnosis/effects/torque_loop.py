"""torque_loop: what the drive makes of the commanded torque. Shows in r1 where the sensor sees it, in r2
where it does not."""

from __future__ import annotations

import numpy as np

from np_diagnosis.arm.stages import Drive
from np_diagnosis.effects.base import Context, Effect, Parameter, Shape, recurrence, stack

LAGS = tuple(1e-3 * 1.4**n for n in range(10))  # s: so fine that the best one leaves nothing to other effects
SHARE = Parameter("share", "1", 0.0, 3.0, 1.0)
WHOLE = Parameter("share", "1", 0.7, 1.3, 0.02, 1.0)  # all of it, or it is another shape
SCALE_KNOWN = 0.005  # to which the torque constant of any drive is known
RAMP_KNOWN = 0.02  # of a rate: within a period a drive may ramp, or step at its end
LEVELS = tuple(0.95 * 0.88**n for n in range(8))  # of the largest torque or rate commanded
REACHED = (0.97, 1.0)  # of the largest torque measured: a drive at its limit is there again and again
AVERAGE_KNOWN = 4e-4  # s: whether a period's measured torque is its mean or its end makes .4 of a period


def effects(context: Context) -> list[Effect]:
    """Effects of a single joint."""
    scale = Parameter("scale", "1", -0.5, 0.5, 0.03, least=SCALE_KNOWN)
    offset = Parameter("offset", "Nm", -5.0, 5.0, 0.5)
    found = [
        Effect(
            "torque_scale",
            (scale,),
            {"r2": lambda c, j: stack(-c.prediction.load[:, j])},
            "gain of the torque loop",
            "unseen by the sensor",
        ),
        Effect(
            "torque_offset",
            (offset,),
            {"r2": lambda c, j: -np.ones((len(c.samples), 1))},
            GAZ_OFFSET,
            "unseen by the sensor",
        ),
    ]
    if context.drive is None:
        return found
    found += [
        Effect(
            "torque_scale",
            (scale,),
            {"r1": lambda c, j: stack(c.drive.commanded[:, j] + c.drive.gravity[:, j])},
            "gain of the torque loop",
        ),
        Effect(
            "torque_scale",
            (scale,),
            {"r1": lambda c, j: stack(c.drive.commanded[:, j])},
            "gain of the torque loop",
            "gravity apart",
        ),
        Effect(
            "torque_offset",
            (offset,),
            {"r1": lambda c, j: np.ones((len(c.drive.time), 1))},
            GAZ_OFFSET,
        ),
    ]
    found += [_lag(t) for t in LAGS]
    for j in range(len(context.arm)):
        largest = np.abs(context.drive.commanded[:, j]).max()
        reached = float(np.percentile(np.abs(context.drive.measured[:, j]), 99.8))
        found += [_saturation(level * largest, j) for level in LEVELS]
        found += [_saturation(level * reached, j) for level in REACHED]
        fastest = np.abs(np.diff(context.drive.commanded[:, j])).max() / context.drive.period
        found += [_rate_limit(level * fastest, j) for level in LEVELS]
    return found


GAZ_OFFSET = "Gaz et al., RA-L 2019"


def first_order(d: Drive, values: np.ndarray, lag: float) -> np.ndarray:
    """values (n,) through a first-order lag of `lag` s, from rest at the beginning of each stretch."""
    kept = np.exp(-d.period / lag)
    decay, inflow = np.full(len(values), kept), (1 - kept) * values
    decay[d.starts], inflow[d.starts] = 0.0, values[d.starts]
    return recurrence(decay, inflow)


def rate_limited(d: Drive, values: np.ndarray, rate: float) -> np.ndarray:
    """values (n,) followed at no more than `rate` a second."""
    step, limited = rate * d.period, values.copy()
    jumps = np.abs(np.diff(values, prepend=values[:1])) > step
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


def _lag(lag: float) -> Effect:
    return Effect(
        "actuator_lag",
        (SHARE,),
        {"r1": lambda c, j: stack(first_order(c.drive, c.drive.commanded[:, j], lag) - c.drive.commanded[:, j])},
        "first-order torque loop",
        f"{1e3 * lag:.3g} ms",
        Shape("time_constant", "s", lag, _lag, linear=True, background=AVERAGE_KNOWN, least=4e-4),
    )


def _saturation(limit: float, joint: int) -> Effect:
    return Effect(
        "torque_saturation",
        (WHOLE,),
        {"r1": lambda c, j: stack(np.clip(c.drive.commanded[:, j], -limit, limit) - c.drive.commanded[:, j])},
        "largest torque of the drive",
        f"{limit:.3g} Nm",
        Shape("limit", "Nm", limit, lambda value: _saturation(value, joint)),
        only_joint=joint,
    )


def _rate_limit(limit: float, joint: int) -> Effect:
    return Effect(
        "torque_rate_limit",
        (WHOLE,),
        {"r1": lambda c, j: stack(rate_limited(c.drive, c.drive.commanded[:, j], limit) - c.drive.commanded[:, j])},
        "largest rate of the drive",
        f"{limit:.3g} Nm/s",
        Shape("limit", "Nm/s", limit, lambda value: _rate_limit(value, joint), background=RAMP_KNOWN * limit),
        only_joint=joint,
    )
