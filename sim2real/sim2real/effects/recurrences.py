"""Recurrences over whole recordings, in a few passes over arrays."""

from __future__ import annotations

import numpy as np

from sim2real.effects.evidence import Drive

NOTHING = 1e-18  # of a value is lost in rounding
TINY = 1e-300  # where nothing moves at all
SMOOTH = 5  # samples of the fine grid
SURE_SPEED = 0.003  # rad/s at which the direction of recorded motion is sure


def linear_recurrence(decay: np.ndarray, inflow: np.ndarray) -> np.ndarray:
    """x (n,) of x[i] = decay[i] x[i - 1] + inflow[i], x[-1] = 0, in log2 n passes over the whole array.

    Pairs of neighbouring steps are one step, pairs of those another (Hillis and Steele 1986); what is further away than the
    decay reaches is left out.
    """
    decay, x = decay.copy(), inflow.copy()
    reach = 1
    while reach < len(x) and decay[reach:].max() > NOTHING:
        x[reach:] += decay[reach:] * x[:-reach]
        decay[reach:] *= decay[:-reach]
        reach *= 2
    return x


def play_operator(middle: np.ndarray, reach: float) -> np.ndarray:
    """x (n, ...) that follows values (n, ...) only where they leave it behind by more than a reach, from the first of them on.

    It is a step x[i] = clip(x[i - 1], low[i], high[i]); two such steps are one of the same kind, so that pairs are joined as in
    `linear_recurrence`, to the last bit what one step after the other gives.
    """
    low, high = middle - reach, middle + reach
    low[0] = high[0] = middle[0]
    step = 1
    while step < len(middle) and (low[step:] < high[step:]).any():  # else every one is known, wherever it began
        low[step:], high[step:] = (np.clip(end[:-step], low[step:], high[step:]) for end in (low, high))
        step *= 2
    return low


def first_order_lag(d: Drive, values: np.ndarray, lag: float) -> np.ndarray:
    """values (n,) through a first-order lag of `lag` s, from rest at the beginning of each stretch."""
    factor = np.exp(-d.period / lag)
    decay, inflow = np.full(len(values), factor), (1 - factor) * values
    decay[d.starts], inflow[d.starts] = 0.0, values[d.starts]
    return linear_recurrence(decay, inflow)


def mean_lagged_torque(d: Drive, values: np.ndarray, lag: float) -> np.ndarray:
    """Mean over each period (n,) of what a torque loop with a lag of `lag` s makes of commands (n,) held for a period."""
    ends = first_order_lag(d, values, lag)
    begins = np.concatenate([values[:1], ends[:-1]])
    begins[d.starts] = values[d.starts]
    return values + (begins - values) * lag / d.period * (1 - np.exp(-d.period / lag))


def dahl_state(position: np.ndarray, stroke: float) -> np.ndarray:
    """Dahl's friction (m,) over its level, -1..1, from the distance moved; exact for motion that does not turn between two
    samples."""
    # An encoder's noise is no motion: over a short stroke it would wear the state away.
    smooth = np.convolve(np.pad(position, SMOOTH // 2, mode="edge"), np.full(SMOOTH, 1 / SMOOTH), mode="valid")
    return bristle_state(np.diff(smooth, prepend=smooth[:1]), stroke)


def bristle_state(moved: np.ndarray, stroke: float, shaken: float = 0.0) -> np.ndarray:
    """z (m,), -1..1, of dz = (dx - |dx| z) / stroke for steps `moved` (m,): Dahl's and Bouc and Wen's state.

    shaken: what moves to and fro besides in each step, across rather than on top of it; it lets go of z and winds nothing up.
    """
    path = np.maximum(np.hypot(moved, shaken), TINY)
    decay = np.exp(-path / stroke)
    return linear_recurrence(decay, moved / path * (1 - decay))


def bristle_deflection(position: np.ndarray, reach: float) -> np.ndarray:
    """How far a bristle is bent that a joint drags along, as a share (m,), -1 to 1, of its reach rad.

    It is what the play operator leaves of a smoothed position (m,) rad.
    """
    padded = np.pad(position, SMOOTH // 2, mode="edge")
    smooth = np.convolve(padded, np.full(SMOOTH, 1 / SMOOTH), mode="valid")
    return (smooth - play_operator(smooth, reach)) / reach


def smooth_sign(velocity: np.ndarray) -> np.ndarray:
    """Direction of recorded motion, -1..1, smooth through standstill."""
    return np.tanh(velocity / SURE_SPEED)
