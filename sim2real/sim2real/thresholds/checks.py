"""Thresholds of the checks: what a recording must satisfy, and when a model is no explanation."""

from __future__ import annotations

from dataclasses import dataclass

from sim2real.thresholds.entry import DEVELOPMENT, JUDGEMENT, NUMERICS, threshold


@dataclass(frozen=True)
class Recordings:
    """What a recording must be (recordings/)."""

    period_tolerance: float = threshold(0.05, "1", "by which the period of joint states may differ", JUDGEMENT)
    rates: tuple[float, float] = threshold(
        (100.0, 10000.0),
        "Hz",
        "rates of a recording without a rate of its own",
        "otherwise its times are not in seconds",
    )
    answer: float = threshold(0.5, "periods", "by which the state after a command may be late or early", JUDGEMENT)
    command_gap: float = threshold(1.5, "periods", "between commands from which a new stretch begins", JUDGEMENT)
    loss: float = threshold(0.02, "1", "share of joint states that may be missing", JUDGEMENT)
    largest_gap: float = threshold(0.05, "s", "without data over which nothing is interpolated", JUDGEMENT)
    shortest: float = threshold(1.0, "s", "shortest stretch without a gap that is used", JUDGEMENT)
    stretch: float = threshold(6.0, "s", "stretches of which a quick look is made", "two blocks of the design")
    short: float = threshold(45.0, "s", "in all that a quick look takes", "3 to 4 s of computation on two cores")


@dataclass(frozen=True)
class Plausibility:
    """Units, signs and order of joints (checks/plausibility.py)."""

    range_slack: float = threshold(0.05, "rad", "beyond the joint limits that a position may be", JUDGEMENT)
    speed_slack: float = threshold(1.5, "1", "times the speed limit that a joint may move", JUDGEMENT)
    speed_percentile: float = threshold(
        75.0, "% of the time", "that a joint keeps to its speed", "a wrist that swung: development case, seed 11"
    )
    rows: int = threshold(300, "samples", "that the dynamics are tried on", NUMERICS)
    decisive: float = threshold(
        3.0, "nats", "that a joint's log residual must fall by under other units, signs or names", JUDGEMENT
    )
    slope: tuple[float, float] = threshold(
        (0.7, 1.4), "1", "derivative of the position over the velocity", "factor sqrt(2) to either side"
    )
    velocity_step: float = threshold(0.01, "s", "over which positions are differentiated", JUDGEMENT)
    torque_error: float = threshold(1e-3, "of the torque limit", "that is no error of a torque", JUDGEMENT)


@dataclass(frozen=True)
class Effort:
    """Which torque is measured (checks/effort_side.py)."""

    share: float = threshold(0.4, "of the nominal friction", "below which a torque holds none of it", JUDGEMENT)
    rows: int = threshold(100, "samples", "fewest in which a joint slides for it to be asked", JUDGEMENT)
    smooth: int = threshold(9, "samples", "over which speed is averaged before its sign and slope count", NUMERICS)


@dataclass(frozen=True)
class Current:
    """Torque constants of motors from a recording (recordings/current.py, inference/gains.py)."""

    rows: int = threshold(100, "samples", "fewest in which a joint slides for its constant to be asked", JUDGEMENT)
    sure: float = threshold(0.1, "of the constant", "largest standard error of a constant that is used", JUDGEMENT)
    known: float = threshold(0.02, "1", "to which the weights are known that a constant is told by", JUDGEMENT)
    spread: float = threshold(0.3, "of the constant", "by which effects may have spoilt a first estimate", JUDGEMENT)
    settled: float = threshold(0.003, "of the constant", "change after which it is settled", NUMERICS)
    rounds: int = threshold(3, "rounds", "of settling constants with the effects found", NUMERICS)


@dataclass(frozen=True)
class Floor:
    """How well the data repeat (checks/floor.py)."""

    distance: float = threshold(1.0, "s", "between two passes through the same state", JUDGEMENT)
    near_position: float = threshold(0.02, "rad", "within which two states of a joint are the same", JUDGEMENT)
    near_velocity: float = threshold(0.05, "rad/s", "likewise", JUDGEMENT)
    near_acceleration: float = threshold(0.3, "rad/s^2", "likewise", JUDGEMENT)
    pairs: int = threshold(40, "pairs", "of passes from which the floor is measured", JUDGEMENT)


@dataclass(frozen=True)
class Shrinkage:
    """How far the gap shrinks, and where (checks/shrinkage.py, report/document.py)."""

    bootstraps: int = threshold(300, "draws", "of the bootstrap over blocks", NUMERICS)
    blocks: int = threshold(3, "blocks", "in which a joint must move to be judged", JUDGEMENT)
    standing: float = threshold(0.02, "rad/s", "speed up to which a joint stands", JUDGEMENT)
    fast: float = threshold(0.3, "rad/s", "speed from which a joint is fast", JUDGEMENT)
    accelerating: float = threshold(2.0, "rad/s^2", "acceleration from which a joint accelerates", JUDGEMENT)
    twist_weight: float = threshold(1e8, "Nm^2/rad^2", "of a square of twist beside one of torque", "0.1 mrad as 1 Nm")
    worse: float = threshold(1.05, "1", "growth of the gap of a regime beyond which it is named", JUDGEMENT)


@dataclass(frozen=True)
class Omnibus:
    """The omnibus test of lack of fit by a flexible model (checks/omnibus.py)."""

    harmonics: int = threshold(6, "harmonics", "of the joint's angle in the flexible model", JUDGEMENT)
    direction_speed: float = threshold(
        0.01, "rad/s", "at which the direction of motion is sure at the rate of the controller", JUDGEMENT
    )
    outlying: float = threshold(
        5.0,
        "standard deviations",
        "beyond which a value is no noise",
        "one of two million values of a normal distribution",
    )
    blocks: int = threshold(4, "blocks", "fewest that a cell is tested on", JUDGEMENT)


@dataclass(frozen=True)
class Verdict:
    """From the model and its lack of fit to the verdict (diagnosis.py)."""

    certain: float = threshold(0.8, "1", "probability from which an effect counts as identified", JUDGEMENT)
    explained: float = threshold(
        0.8, "1", "of what is predictable at all that a model must explain", "docs/diagnosis.md, development cases"
    )
    gain: float = threshold(25.0, "nats", "by which the flexible model must predict better", DEVELOPMENT)
    gain_errors: float = threshold(2.0, "standard errors", "over blocks, likewise", DEVELOPMENT)
    coloured: float = threshold(
        1.5, "1", "times its white part, from which what is left of r2 is no noise", DEVELOPMENT
    )
    coloured_explained: float = threshold(0.9, "1", "of what is no white noise that a model must explain", DEVELOPMENT)
    torque: float = threshold(0.0005, "of the torque limit", "RMS below which nothing is left", DEVELOPMENT)
    quantum: float = threshold(2e-5, "rad", "step of an encoder from which it is named", JUDGEMENT)
    quantum_error: float = threshold(0.01, "of the step", "half width of its interval", JUDGEMENT)
    per_joint: int = threshold(
        2, "effects", "needed at a joint up to which they explain it, those of the arm included", DEVELOPMENT
    )
    needed: float = threshold(
        0.05, "1", "of a stage's squares that are left over without an effect that is needed", DEVELOPMENT
    )
    at_bound: float = threshold(0.98, "of the bound", "from which on a parameter is at its bound", NUMERICS)
    listed_probability: float = threshold(0.02, "1", "from which an alternative is listed", JUDGEMENT)
    listed: int = threshold(8, "findings", "beyond which no alternative is listed", JUDGEMENT)


@dataclass(frozen=True)
class Constancy:
    """Whether an effect has one size, and r3 follows the load alone (checks/constancy.py)."""

    gain: float = threshold(60.0, "nats", "by which the columns of a question must predict better", DEVELOPMENT)
    gain_errors: float = threshold(
        1.5, "standard errors", "over blocks: what changes with time is in some blocks only", DEVELOPMENT
    )
    of_left: float = threshold(0.15, "1", "of the squares that the model leaves", DEVELOPMENT)
    of_null: float = threshold(
        0.003, "1", "of the squares without any effect", "a law of an effect is off by up to a twentieth of its size"
    )
    torque: float = threshold(0.0002, "of the torque limit", "RMS that matters", DEVELOPMENT)
    twist: float = threshold(3e-5, "rad", "RMS that matters", DEVELOPMENT)
    blocks: int = threshold(4, "blocks", "fewest that a cell is asked with", JUDGEMENT)
    lags: tuple[int, ...] = threshold(
        (1, 2, 3, 4, 6, 8), "samples", "ago at which the memory of an acceleration is looked for", "a third of a second"
    )
    slip_window: float = threshold(10.0, "s", "on either side of a jump between the encoders", JUDGEMENT)
    slip_samples: int = threshold(10, "samples", "fewest on either side of a jump", JUDGEMENT)
    slip_lasting: float = threshold(
        10.0, "1", "times what either side stays within, for a jump that lasts", DEVELOPMENT
    )
    slip_quantile: float = threshold(0.9, "1", "of the samples that stay within", DEVELOPMENT)
    slip_steps: int = threshold(2, "samples", "on either side within which a jump comes at once", DEVELOPMENT)
    slip_share: float = threshold(0.7, "1", "of a jump that comes at once", DEVELOPMENT)


@dataclass(frozen=True)
class Standstill:
    """Friction that depends on the time at rest (checks/standstill.py)."""

    still: float = threshold(0.005, "rad/s", "speed up to which a joint stands", JUDGEMENT)
    shortest: float = threshold(0.06, "s", "of a rest; what is shorter is a turn, or noise", JUDGEMENT)
    fade: float = threshold(0.08, "s", "for which a rest is remembered once the joint moves", DEVELOPMENT)
    long: float = threshold(0.5, "s", "from which on a rest is long", DEVELOPMENT)
    share: float = threshold(
        0.2, "1", "of what is left at reversals that the time at rest explains", "a clean arm: below 0.01"
    )
    torque: float = threshold(0.00025, "of the torque limit", "RMS that matters", DEVELOPMENT)
    fresh: float = threshold(0.3, "1", "memory of a rest from which a row counts as shortly after it", JUDGEMENT)
    rows: int = threshold(10, "rows", "fewest shortly after a rest", JUDGEMENT)
