"""Thresholds of slow planar pushes (chain/)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sim2real.thresholds.entry import JUDGEMENT, NUMERICS, threshold


@dataclass(frozen=True)
class Pushing:
    """Which windows of a push count (chain/pushing.py)."""

    window: float = threshold(0.1, "s", "length of a window", "longer than a period of an arm's vibration")
    free: float = threshold(0.3, "s", "without contact at the beginning, from which the sensor's bias comes", JUDGEMENT)
    moved: float = threshold(0.001, "m", "from its place at the beginning at which the object has moved", JUDGEMENT)
    onset: float = threshold(5.0, "1", "times the noise from which a force is a contact", JUDGEMENT)
    least_force: float = threshold(0.1, "N", "smallest force of a contact", JUDGEMENT)
    least_speed: float = threshold(0.01, "m/s", "slowest object that slides", JUDGEMENT)
    contact_share: float = threshold(0.3, "1", "of the usual force below which the tip has left", JUDGEMENT)
    settling: int = threshold(3, "windows", "left out where contact begins", JUDGEMENT)
    leaving: int = threshold(2, "windows", "left out where contact ends", JUDGEMENT)
    least_windows: int = threshold(6, "windows", "fewest of a push", JUDGEMENT)
    least_rows: int = threshold(10, "rows", "fewest of a stream", JUDGEMENT)
    least_in_window: int = threshold(3, "rows", "fewest through which a line is drawn", NUMERICS)
    unit: float = threshold(1e-3, "1", "by which the length of a quaternion may differ from one", NUMERICS)


@dataclass(frozen=True)
class PushModel:
    """The quasi-static model (chain/limit_surface.py)."""

    usual_speed: float = threshold(0.1, "m/s", "at which friction is what it is called", JUDGEMENT)
    slowest: float = threshold(0.005, "m/s", "below which friction no longer follows the speed", JUDGEMENT)
    no_slip: float = threshold(0.006, "m/s", "speed along the face that may be noise of a window", JUDGEMENT)
    sure_slip: float = threshold(0.015, "m/s", "speed along the face at which the tip slides", JUDGEMENT)


def spreads(known: float, varies: float, change: float, unit: str, meaning: str, source: str) -> Any:
    """Three standard deviations: known, before a run is seen; varies, between runs of a set-up; change, of a gap."""
    return threshold((known, varies, change), unit, f"{meaning}: known, between runs, of a gap", source)


@dataclass(frozen=True)
class PushSpreads:
    """What is known of the numbers of a push beforehand (chain/push_parameters.py)."""

    friction: tuple[float, float, float] = spreads(
        2.0, 0.15, 0.7, "1", "log of the friction force", "10 to 20 % between runs: Ma and Rodriguez, RA-L 2018"
    )
    support: tuple[float, float, float] = spreads(
        0.22, 0.1, 0.5, "1", "log of the support's radius over the side", ".30 to .72, a patch and four corners"
    )
    tip_friction: tuple[float, float, float] = spreads(0.6, 0.2, 0.7, "1", "log of the tip's friction", JUDGEMENT)
    half_side: tuple[float, float, float] = spreads(0.003, 0.001, 0.005, "m", "half side", JUDGEMENT)
    centre: tuple[float, float, float] = spreads(0.003, 0.002, 0.015, "m", "centre of friction", JUDGEMENT)
    anisotropy: tuple[float, float, float] = spreads(
        0.05, 0.03, 0.15, "1", "anisotropy", "ratios of 1.05 to 1.5 are published for planar pushes"
    )
    speed: tuple[float, float, float] = spreads(0.05, 0.03, 0.2, "1", "exponent of the speed", JUDGEMENT)
    place: tuple[float, float, float] = spreads(0.5, 0.3, 3.0, "1/m", "gradient of log friction", JUDGEMENT)
    marker: tuple[float, float, float] = spreads(0.005, 0.003, 0.005, "m", "the tracked frame's origin", JUDGEMENT)
    heading: tuple[float, float, float] = spreads(0.03, 0.015, 0.03, "rad", "the tracked frame's turn", JUDGEMENT)
    registration: tuple[float, float, float] = spreads(
        0.005,
        0.002,
        0.01,
        "m",
        "the tip's place in the world",
        "hand-eye results of public sessions are off by 4 to 29 mm",
    )
    sensor_turn: tuple[float, float, float] = spreads(0.05, 0.01, 0.02, "rad", "turn of the sensor", JUDGEMENT)
    bias: tuple[float, float, float] = spreads(0.05, 0.03, 0.03, "N", "what is left of the sensor's bias", JUDGEMENT)


@dataclass(frozen=True)
class PushFit:
    """Pushes beside the model (chain/push_fit.py)."""

    freedom: float = threshold(4.0, "1", "runs that the usual spread between runs is worth", JUDGEMENT)
    tails: float = threshold(4.0, "1", "degrees of freedom of a window's noise, Student's", JUDGEMENT)
    registration: float = threshold(1.0, "m", "of frames that have never been brought together", NUMERICS)
    least_runs: int = threshold(3, "runs", "fewest from which a set-up is identified", JUDGEMENT)
    passes: int = threshold(4, "passes", "alternations between numbers, their spread and noise", NUMERICS)
    steps: int = threshold(60, "steps", "most of an optimisation", NUMERICS)
    tolerance: float = threshold(1e-5, "1", "relative change of the cost at which an optimisation ends", NUMERICS)
    first_tails: float = threshold(100.0, "1", "the same of windows' noise where the search begins", NUMERICS)
    first_tolerance: float = threshold(1e-2, "1", "the same of the cost there", NUMERICS)
    lags: int = threshold(3, "windows", "over which windows are taken to say the same", JUDGEMENT)
    noise: tuple[float, ...] = threshold(
        (0.1, 0.05, 0.003, 0.001, 0.08), "1, rad, m, m, rad", "of a window before any is seen, by channel", JUDGEMENT
    )
    least_noise: tuple[float, ...] = threshold(
        (0.03, 0.015, 0.0005, 0.0003, 0.02), "1, rad, m, m, rad", "smallest noise of a window, by channel", JUDGEMENT
    )


@dataclass(frozen=True)
class PushChange:
    """What changed between pushes (chain/push_change.py)."""

    prior: float = threshold(8.0, "candidates", "equally probable effects that a candidate is one of", "the catalogue")
    gain: float = threshold(3.0, "nats", "that an effect must gain beyond its log prior", "as of the arm's effects")
    equal: float = threshold(3.0, "nats", "within which two models explain the same", "as of the arm's effects")
    most: int = threshold(2, "effects", "that are named at once", JUDGEMENT)
    misfit: float = threshold(
        2.0, "1", "times the noise of the reference beyond which what is left is unexplained", JUDGEMENT
    )
    strain: float = threshold(4.0, "1", "standard deviations by which a nuisance may be off", JUDGEMENT)


@dataclass(frozen=True)
class Sliding:
    """Friction from free slides (chain/sliding.py)."""

    smoothing: float = threshold(0.03, "s", "over which speeds are averaged to find slides", JUDGEMENT)
    rise: float = threshold(0.03, "m/s", "vertical speed up to which an object lies flat", JUDGEMENT)
    rocking: float = threshold(0.5, "rad/s", "rate of tilting up to which it does", JUDGEMENT)
    slowest: float = threshold(0.05, "m/s", "speed down to which a slide counts", JUDGEMENT)
    shortest: float = threshold(0.06, "s", "shortest slide", JUDGEMENT)
    least: int = threshold(3, "slides", "fewest from which friction is given", JUDGEMENT)
    coloured: float = threshold(3.0, "1", "factor of a tracker's variance as its noise is not white", JUDGEMENT)
    spread: float = threshold(0.03, "1", "usual spread of mu from slide to slide", "10 to 20 % of .2 to .3")
    tilt: float = threshold(0.01, "rad", "standard deviation of a table's tilt", ".1 to 1 degree")
    tails: float = threshold(4.0, "1", "degrees of freedom of a slide, Student's", JUDGEMENT)
    passes: int = threshold(5, "passes", "alternations between mu and its spread", NUMERICS)
