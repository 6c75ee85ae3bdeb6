"""Signals of the joints on common rows, smoothed, and what a wrong convention makes of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from sim2real.recordings.signals import Log

WINDOW = 0.04  # s over which signals are averaged
SAMPLES = 800  # moments of a recording that are used
MEASURED = ("position", "velocity", "effort")
COMMANDED = ("target", "target_velocity", "command")
RATES = {"position": ("speed",), "velocity": ("acceleration",), "target_velocity": ("target_acceleration",)}
"""By signal, its time derivatives, which have its convention too."""


@dataclass(frozen=True, eq=False)
class JointSignals:
    """Signals (n, k) of k joints, means over `WINDOW` s at n moments; those of a controller None where none was recorded."""

    position: np.ndarray
    """rad."""
    speed: np.ndarray
    """Slope of the position, rad/s."""
    velocity: np.ndarray
    """As measured, rad/s."""
    acceleration: np.ndarray
    """Slope of the velocity, rad/s^2."""
    effort: np.ndarray
    """Torque as measured, Nm, or motor current, A."""
    target: np.ndarray | None = None
    """rad."""
    target_velocity: np.ndarray | None = None
    """rad/s."""
    target_acceleration: np.ndarray | None = None
    """Slope of the target's velocity, rad/s^2."""
    command: np.ndarray | None = None
    """Commanded torque Nm of the period in which the effort was measured."""
    stiffness: np.ndarray | None = None
    """Gain Nm/rad; None where the law is not known."""
    damping: np.ndarray | None = None
    """Gain Nm s/rad."""

    def change(self, names: tuple[str, ...], function) -> JointSignals:
        """The same with a function of an array (n, k) applied to the named signals and their derivatives."""
        every = [one for name in names for one in (name, *RATES.get(name, ()))]
        return replace(self, **{name: function(value) for name in every if (value := getattr(self, name)) is not None})

    def scale_gains(self, factor: float) -> JointSignals:
        """The same with stiffness times a factor, and damping for the same ratio."""
        if self.stiffness is None:
            return self
        return replace(self, stiffness=factor * self.stiffness, damping=np.sqrt(factor) * self.damping)


def joint_signals(log: Log) -> JointSignals:
    """Of a log: at most `SAMPLES` moments, evenly among those without a gap in their window."""
    period = float(np.median(np.diff(log.time)))
    half = max(1, round(WINDOW / period / 2))
    c = log.commands
    rows = np.arange(len(log.time)) if c is None else c.rows
    time = log.time[rows]
    # An effort is the mean over the period that ends at its stamp, a command acts in the one that begins there.
    effort = log.torque[np.minimum(rows + 1, len(log.time) - 1)] if c is not None else log.torque[rows]
    span = np.full(len(rows), np.inf)
    span[2 * half : -2 * half or None] = time[4 * half :] - time[: -4 * half]
    whole = np.flatnonzero(span < 4.5 * half * period)
    picked = whole[:: max(1, -(-len(whole) // SAMPLES))]

    def mean(values: np.ndarray) -> np.ndarray:
        return uniform_filter1d(np.asarray(values, float), 2 * half + 1, axis=0, mode="nearest")

    def slope(values: np.ndarray) -> np.ndarray:
        smooth = mean(values)
        return (np.roll(smooth, -half, axis=0) - np.roll(smooth, half, axis=0)) / (2 * half * period)

    position, velocity = log.position[rows], log.velocity[rows]
    signals = {
        "position": mean(position),
        "speed": slope(position),
        "velocity": mean(velocity),
        "acceleration": slope(velocity),
        "effort": mean(effort),
    }
    if c is not None:
        signals |= {
            "target": mean(c.target),
            "target_velocity": mean(c.target_velocity),
            "target_acceleration": slope(c.target_velocity),
            "command": mean(c.torque),
        }
        if c.has_law:
            signals |= {"stiffness": mean(c.stiffness), "damping": mean(c.damping)}
    return JointSignals(**{name: value[picked] for name, value in signals.items()})
