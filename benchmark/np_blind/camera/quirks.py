"""Properties of a camera and a detector without fault, drawn for every case: none of them is a gap, and the diagnosis is given none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Quirks:
    """rows s: from the picture's first row to its last; exposure s: of each row; jitter s: standard deviation of a stamp, which is more
    often a little early and now and then late; lens: k1, k2, p1, p2 of Brown and Conrady that a calibration has left; noise px, memory: of a
    corner's error that is correlated with the image before; white px: of one that is not; gross: share of corners that are somewhere else; lost:
    share of the images in which a corner behind the hand has no score that counts; beneath px: by which it is off, score or not."""

    rows: float = 0.0
    exposure: float = 0.0
    jitter: float = 0.0
    lens: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    noise: float = 0.0
    memory: float = 0.0
    white: float = 0.0
    gross: float = 0.0
    lost: float = 0.0
    beneath: float = 0.0


LENS = (0.011, 0.075, 0.0012, 0.0012)
"""Each at most: .25 px in the picture's corners by k1 and k2, .15 px by p1 and p2. Calibrations leave .1 to .5 px."""


def draw(rng: np.random.Generator) -> Quirks:
    """Evenly within ranges.

    rows: published readouts of cameras at 30 Hz are 14 to 32 ms a frame (Ringaby and Forssen 2011, and others after them), of which our crop has
    496 of 720 rows; a global shutter has none. exposure: a RealSense's colour camera begins at 15.6 ms, and indoors not much below 2. jitter:
    5 ms are twice its deviation at most, which is what candidates are to bear. lens: see `LENS`. beneath: from half of what the catalogue
    counts as an effect to its lower end. All others about what the released detector has at rest.
    """

    def within(low: float, high: float) -> float:
        return float(f"{rng.uniform(low, high):.9g}")  # the last digits may differ between machines

    return Quirks(
        rows=within(0.0, 0.022),
        exposure=within(0.002, 0.016),
        jitter=within(0.0, 0.0025),
        lens=tuple(within(-most, most) for most in LENS),
        noise=within(0.08, 0.22),
        memory=within(0.6, 0.9),
        white=within(0.1, 0.35),
        gross=within(0.001, 0.007),
        lost=within(0.3, 0.9),
        beneath=within(1.0, 4.0),
    )
