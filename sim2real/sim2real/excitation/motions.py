"""Joint motions as functions of time, made to be added to a posture: they begin and end at rest, at zero.

Each returns offset (n, 7) rad and its velocity (n, 7) rad/s at the times (n,) s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

Motion = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def waves(duration: float, amplitude: np.ndarray, frequency: np.ndarray, phase: np.ndarray) -> Motion:
    """Sums of sinusoids of each joint, faded in and out.

    amplitude rad, frequency Hz, phase rad: (m, 7) for m sinusoids a joint. duration: s.
    """
    omega = 2 * np.pi * np.atleast_2d(frequency)

    def motion(time: np.ndarray):
        angle = omega * time[:, None, None] + phase
        fade, slope = _fade(time, duration, min(1.0, duration / 4))
        wave = (amplitude * np.sin(angle)).sum(axis=1)
        speed = (amplitude * omega * np.cos(angle)).sum(axis=1)
        return fade * wave, fade * speed + slope * wave

    return motion


def chirp(duration: float, speed: np.ndarray, frequencies: tuple[float, float], largest: float) -> Motion:
    """A sinusoid whose frequency rises exponentially between two `frequencies`, Hz.

    speed (7,) rad/s: its amplitude of velocity, the same at all frequencies but where the amplitude of
    position would be greater than `largest`, rad.
    """
    low, high = frequencies
    rate = np.log(high / low) / duration

    def motion(time: np.ndarray):
        frequency = low * np.exp(rate * time)
        phase = 2 * np.pi * (frequency - low) / rate
        omega = 2 * np.pi * frequency
        # Smooth in between: amplitude = speed / sqrt(omega^2 + (speed / largest)^2).
        corner = np.divide(speed, largest)
        root = np.sqrt(omega[:, None] ** 2 + corner**2)
        amplitude = speed / root
        growth = -amplitude * (omega**2 * rate)[:, None] / root**2
        fade, slope = _fade(time, duration, 0.5)
        wave, turn = np.sin(phase)[:, None], np.cos(phase)[:, None]
        offset = amplitude * wave
        return fade * offset, fade * (growth * wave + amplitude * omega[:, None] * turn) + slope * offset

    return motion


def triangle(stroke: float, speed: np.ndarray, turn: float, cycles: int) -> tuple[float, Motion]:
    """(duration s, motion) at constant `speed` (7,) rad/s out and back, `cycles` times.

    stroke: s from one reversal to the next; turn: s that a reversal takes.
    """
    if not 0 < turn < stroke:
        raise ValueError(f"expected reversals shorter than a stroke of {stroke} s, got {turn} s")
    # The velocity's knots: rest, then alternately + and - with a smooth passage in between.
    knots = [(0.0, 0.0)]
    for k in range(2 * cycles):
        sign = 1.0 if k % 2 == 0 else -1.0
        knots += [(k * stroke + turn, sign), ((k + 1) * stroke, sign)]
    knots.append((2 * cycles * stroke + turn, 0.0))
    times, signs = map(np.array, zip(*knots))

    def motion(time: np.ndarray):
        velocity, position = _smooth_steps(times, signs, time)
        return position[:, None] * speed, velocity[:, None] * speed

    return float(times[-1]), motion


def visits(stops: Sequence[np.ndarray], travel: float, rest: float) -> tuple[float, Motion]:
    """(duration s, motion) from zero to each of the `stops` (7,) rad and back to zero.

    travel: s of each move, with the least jerk; rest: s of standstill after it.
    """
    points = np.array([np.zeros_like(stops[0]), *stops, np.zeros_like(stops[0])])
    period = travel + rest
    duration = period * (len(points) - 1)

    def motion(time: np.ndarray):
        k = np.clip((time // period).astype(int), 0, len(points) - 2)
        share, rate = least_jerk((time - k * period) / travel)
        step = points[k + 1] - points[k]
        return points[k] + share[:, None] * step, rate[:, None] / travel * step

    return duration, motion


def least_jerk(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Share of the way and its rate of change with s, from rest at s <= 0 to rest at s >= 1."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2


def _fade(time: np.ndarray, duration: float, ramp: float) -> tuple[np.ndarray, np.ndarray]:
    """A window (n, 1) that rises and falls within `ramp` s, and its derivative."""
    into, into_rate = least_jerk(time / ramp)
    out, out_rate = least_jerk((duration - time) / ramp)
    return (into * out)[:, None], ((into_rate * out - into * out_rate) / ramp)[:, None]


def _smooth_steps(times: np.ndarray, values: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A function through the knots, with the cubic 3 s^2 - 2 s^3 in between, and its integral from 0."""
    span, rise = np.diff(times), np.diff(values)
    area = np.concatenate([[0.0], np.cumsum(span * (values[:-1] + rise / 2))])
    k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(span) - 1)
    s = np.clip((at - times[k]) / span[k], 0.0, 1.0)
    value = values[k] + rise[k] * s**2 * (3 - 2 * s)
    return value, area[k] + span[k] * (values[k] * s + rise[k] * (s**3 - s**4 / 2))
