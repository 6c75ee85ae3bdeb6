"""What the recordings hold, prepared once: samples, nominal prediction, drive, hints for what to look for."""

from __future__ import annotations

import numpy as np

from sim2real.arm.model import Arm
from sim2real.arm.nominal_prediction import Prediction, make_drive, predict_torques
from sim2real.arm.sampled_dynamics import SampledDynamics
from sim2real.effects.evidence import Context, Drive, Transmission
from sim2real.effects.recurrences import play_operator
from sim2real.effects.sensing.encoder_quantisation import find_quanta
from sim2real.effects.timing.packet_loss import find_lost_packets
from sim2real.recordings.signals import Log, Samples, sample_logs
from sim2real.thresholds import THRESHOLDS

HINTS = THRESHOLDS.hints

BINS = 4096
SMOOTH = 25  # samples of the fine grid to either side
HANN = np.hanning(2 * SMOOTH + 3)[1:-1] / np.hanning(2 * SMOOTH + 3).sum()


def make_context(
    logs: list[Log],
    arm: Arm,
    reference: int = 0,
    constant: np.ndarray | None = None,
    laid_aside: tuple[tuple[int, float, float], ...] = (),
) -> Context:
    """Everything that effects and stages look at; reference: how many of the logs are of the arm as it was; constant,
    laid_aside: of `Context`.

    Raises ValueError where the logs are too short.
    """
    samples = sample_logs(logs, all(log.commands is not None for log in logs))
    prediction = predict_torques(samples, arm)
    driven = make_drive(logs, arm, reference)
    held, share, error, set_aside = (
        (None, 0.0, 0.0, None) if driven is None else find_packets_lost_since(driven, reference)
    )
    return Context(
        arm,
        logs,
        samples,
        prediction,
        SampledDynamics(arm, samples, prediction),
        driven,
        _transmission(logs, samples, prediction),
        _ripples(samples, prediction),
        held,
        share,
        _quanta(logs, reference),
        error,
        set_aside,
        reference,
        constant,
        laid_aside,
    )


def find_packets_lost_since(driven: Drive, reference: int) -> tuple[np.ndarray, float, float, np.ndarray | None]:
    """(held, held_share, held_error, set_aside) of `Context`."""
    found = find_lost_packets(driven)
    if not reference:
        return found.held, *found.share(np.ones(len(found.held), bool)), None
    now = driven.trajectory >= reference
    (share, error), (before, error_before) = found.share(now), found.share(~now)
    error = float(np.hypot(error, error_before))
    is_more = share - before > HINTS.more_lost * error
    return found.held & now & is_more, share - before, error, found.held & ~(now & is_more)


def _quanta(logs: list[Log], reference: int) -> np.ndarray:
    """Steps (k,) rad of the encoders, 0 where none shows or, with a reference, where they are as they were."""
    before, now = (find_quanta(logs[n].position) for n in (0, reference))
    same = np.isclose(now, before, rtol=HINTS.same_step) if reference else np.zeros(len(now), bool)
    return np.where(same, 0.0, now)


def _transmission(logs: list[Log], samples: Samples, prediction: Prediction) -> Transmission | None:
    if any(log.motor is None for log in logs):
        return None
    from scipy.interpolate import CubicSpline  # takes half a second to import, which a quick look has not

    trajectory = np.concatenate([np.full(len(log.time), number) for number, log in enumerate(logs)])
    time = np.concatenate([log.time for log in logs])
    measured = np.concatenate([log.motor - log.position for log in logs])
    twist = _projected(samples, trajectory, time, measured)
    # What moves the links, not what the motor gives: friction and rotor lie before the gear.
    load = prediction.load
    rate = np.gradient(load, axis=0) / np.gradient(samples.time)[:, None]
    ends = np.flatnonzero(np.diff(samples.time, prepend=-np.inf, append=-np.inf)[1:] < 0)
    rate[np.unique(np.clip(np.concatenate([ends, ends + 1]), 0, len(rate) - 1))] = 0.0
    yields = np.array([_slope(load[:, j], twist[:, j]) for j in range(load.shape[1])])
    wound = []
    for number, grid in samples.grids:
        mine = samples.trajectory == number
        first, last = samples.time[mine][[0, -1]]
        straight = yields * CubicSpline(samples.time[mine], load[mine])(np.clip(grid, first, last))
        rows = trajectory == number
        seen = np.column_stack([_between(grid, time[rows], c) for c in measured[rows].T])
        wound.append(straight + _quiet(seen - straight))
    return Transmission(samples.time, samples.trajectory, twist, load, rate, tuple(wound))


def _slope(load: np.ndarray, twist: np.ndarray) -> float:
    """rad/Nm by which a twist (n,) follows a load (n,), of those known."""
    known = np.isfinite(twist)
    away = load[known] - load[known].mean() if known.any() else np.zeros(1)
    return float(away @ twist[known] / (away @ away)) if away @ away > 0 else 0.0


def _between(grid: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (m,) at the times of a grid from those known; zeros where none is."""
    known = np.isfinite(values)
    return np.interp(grid, time[known], values[known]) if known.any() else np.zeros(len(grid))


def _quiet(twist: np.ndarray) -> np.ndarray:
    """A twist (m, k) rad smoothed, and moved only by what is no noise: the play operator."""
    smooth = np.column_stack([np.convolve(np.pad(c, SMOOTH, mode="edge"), HANN, mode="valid") for c in twist.T])
    return play_operator(smooth, HINTS.play)


def _projected(samples: Samples, trajectory: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """values (m, k) at the samples (n, k); NaN where the filter's window has a NaN."""
    is_known = np.isfinite(values)
    projector = samples.projector(trajectory, time)
    found = projector @ np.where(is_known, values, 0.0)
    if not is_known.all():
        found[projector @ (~is_known).astype(float) > 0] = np.nan
    return found


def _ripples(samples: Samples, prediction: Prediction) -> dict[int, tuple[int, ...]]:
    """Orders (1/rad) by joint at which the residual has its highest spectral lines over the joint's angle."""
    residual = samples.torque - prediction.total
    found = {}
    for j in range(residual.shape[1]):
        moving = np.abs(samples.velocity[:, j]) > HINTS.ripple_speed
        if moving.sum() < HINTS.ripple_rows:
            continue
        left = residual[moving, j] - residual[moving, j].mean()
        left = left - prediction.direction[moving, j] * (left * prediction.direction[moving, j]).mean()
        angle = np.floor(samples.position[moving, j] / (2 * np.pi) * BINS).astype(int) % BINS
        power = np.abs(np.fft.rfft(np.bincount(angle, left, BINS)))
        ranked = np.argsort(power[slice(*HINTS.orders)])[::-1] + HINTS.orders[0]
        chosen: list[int] = []
        for order in ranked:
            if all(abs(order - other) > HINTS.order_distance for other in chosen):
                chosen.append(int(order))
            if len(chosen) == HINTS.ripples:
                break
        found[j] = tuple(chosen)
    return found
