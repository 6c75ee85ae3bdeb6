"""Thresholds of the inference: rows, blocks, fits, the search for a model, and what is said of it."""

from __future__ import annotations

from dataclasses import dataclass

from sim2real.effects.recurrences import SURE_SPEED
from sim2real.thresholds.entry import DEVELOPMENT, JUDGEMENT, NUMERICS, threshold


@dataclass(frozen=True)
class Rows:
    """Which rows of a recording count at which stage (arm/stages.py, inference/residuals.py)."""

    stiction_speed: float = threshold(SURE_SPEED, "rad/s", "speed at which the direction of motion is sure", JUDGEMENT)
    standstill: float = threshold(0.02, "rad/s", "speed up to which a joint does not count as sliding", DEVELOPMENT)
    slowest: float = threshold(0.002, "rad/s", "speed below which a joint may be standing at a reversal", JUDGEMENT)
    kink: float = threshold(
        0.02, "rad/s^2", "jump of the target's acceleration beyond which what was fed forward is unknown", JUDGEMENT
    )
    guard: float = threshold(1e-6, "Nm", "from a bound of the controller's guards at which a command is cut", NUMERICS)
    kink_margin: int = threshold(4, "periods", "left out on either side of a gap in the commands", JUDGEMENT)


@dataclass(frozen=True)
class Blocks:
    """Cross-validation: how a recording is cut, and prewhitening (inference/cells.py)."""

    least: int = threshold(10, "blocks", "fewest blocks of a recording", JUDGEMENT)
    duration: float = threshold(3.0, "s", "length of a block of a long recording", JUDGEMENT)
    gap: float = threshold(
        0.5,
        "s",
        "left out of training on either side of a block",
        JUDGEMENT,
    )
    gaps_per_block: float = threshold(3.0, "gaps", "shortest block that can be predicted", JUDGEMENT)
    rows: int = threshold(8, "rows", "fewest rows with which a block says something of a cell", JUDGEMENT)
    order: int = threshold(2, "1", "order of the autoregression that whitens residuals", "Cochrane and Orcutt 1949")
    order_rows: int = threshold(50, "rows", "fewest rows from which an autoregression is estimated", JUDGEMENT)
    order_ridge: float = threshold(1e-3, "1", "ridge of the Yule-Walker equations, of the variance", NUMERICS)

    @property
    def shortest(self) -> float:
        """s of motion from which a recording can be cut into as many blocks."""
        return self.least * self.gaps_per_block * self.gap


@dataclass(frozen=True)
class Fitting:
    """Bounded Bayesian least squares (inference/fit.py)."""

    passes: int = threshold(
        3, "passes", "alternations between parameters and noise, which determine each other", NUMERICS
    )
    bound_passes: int = threshold(2, "passes", "solutions with parameters held at their bounds", NUMERICS)
    variance: float = threshold(1e-16, "unit^2", "smallest variance of a row", NUMERICS)
    rounding: float = threshold(1e-13, "1", "smallest variance, of all that a column explains at its prior", NUMERICS)


@dataclass(frozen=True)
class LoopDelay:
    """The delay of the control loop, estimated before the search (inference/loop_delay.py)."""

    prior: float = threshold(3e-3, "s", "standard deviation of the delay before the recording is looked at", JUDGEMENT)
    longest: float = threshold(30.0, "priors", "longest delay that is looked for", JUDGEMENT)
    command_spread: float = threshold(2e-5, "s", "by which the delay of commands differs between joints", DEVELOPMENT)
    motion_spread: float = threshold(
        1.5e-4, "s", "by which noise of the velocity feigns a delay of the motion", "measured on development cases"
    )


@dataclass(frozen=True)
class Nuisances:
    """Random effects that every arm has and no prediction knows (inference/nuisances.py)."""

    delay: float = threshold(2e-4, "s", "usual delay between command and torque", DEVELOPMENT)
    delay_spread: float = threshold(1.5e-4, "s", "its standard deviation", DEVELOPMENT)
    delay_between: float = threshold(
        5e-5, "s", "standard deviation of its change between two recordings: clocks start at a new phase", JUDGEMENT
    )
    loose_delay_spread: float = threshold(
        1e-3, "s", "the same without commands: torque and motion may come from clocks of their own", JUDGEMENT
    )
    breakaways: tuple[float, float, float] = threshold(
        (1e-4, 2e-4, 5e-4), "rad", "over which friction turns over after a reversal", "measured on development cases"
    )
    breakaway_spread: float = threshold(
        0.7, "1", "standard deviation of the share of the nominal friction that turns over late", DEVELOPMENT
    )
    late_breakaway_spread: float = threshold(1.0, "1", "the same over the longer distances", DEVELOPMENT)
    friction: float = threshold(
        0.015,
        "1",
        "standard deviation of a joint's friction, of what it has",
        "development cases: to .05 it is no fault",
    )
    damping: float = threshold(0.03, "1", "the same of its damping", JUDGEMENT)
    uneven: float = threshold(0.05, "1", "standard deviation of the waves of friction over the angle", JUDGEMENT)
    uneven_orders: tuple[float, ...] = threshold(
        (1.5, 3.0), "1/rad", "orders of those waves: between them they span one to three a turn", NUMERICS
    )
    zero_spread: float = threshold(0.01, "rad", "standard deviation of the zero of a motor's encoder", JUDGEMENT)
    acceleration_error: float = threshold(
        0.001, "1", "error of a filtered acceleration of a motion without noise", JUDGEMENT
    )
    noise_share: float = threshold(
        0.1,
        "1",
        "largest share of a measured acceleration that is taken for noise",
        "Fuller, Measurement Error Models, 1987",
    )
    link_torque: float = threshold(
        1.5e-5, "of the torque limit", "RMS below which a component of the links' errors is not seen", DEVELOPMENT
    )
    gear_yield: float = threshold(1e-5, "rad/Nm", "yield of the stiffest gears", "no gear is stiffer than 1e5 Nm/rad")


@dataclass(frozen=True)
class Hints:
    """What a recording suggests should be looked for (inference/context.py)."""

    ripples: int = threshold(2, "orders", "orders of torque ripple that are tried in a joint", JUDGEMENT)
    orders: tuple[int, int] = threshold((20, 400), "1/rad", "range of orders that are looked at", JUDGEMENT)
    order_distance: int = threshold(2, "1/rad", "orders nearer than this are one line of the spectrum", JUDGEMENT)
    ripple_speed: float = threshold(0.02, "rad/s", "speed from which a row counts for the spectrum", JUDGEMENT)
    ripple_rows: int = threshold(200, "rows", "fewest rows with which a spectrum is looked at", JUDGEMENT)
    play: float = threshold(
        1e-5, "rad", "motion of a smoothed twist that may be noise", "some standard deviations of a smoothed encoder"
    )
    more_lost: float = threshold(3.0, "standard errors", "by which more packets are lost than before", JUDGEMENT)
    always_wound: float = threshold(
        0.04,
        "1",
        "share of what a straight gear leaves of its twist that hysteresis takes away in the earlier recording of an arm that "
        "always had it",
        "development cases: .07 to .96 of six arms with it or a soft gear, to .02 of others",
    )
    same_step: float = threshold(0.05, "of it", "by which an encoder's step differs and is the same", JUDGEMENT)


@dataclass(frozen=True)
class Searching:
    """Which models are tried, and when an effect is added (inference/search.py)."""

    width: int = threshold(6, "models", "models of one size that are grown further", NUMERICS)
    broad: int = threshold(3, "effects", "size up to which several models are grown", NUMERICS)
    per_joint: int = threshold(2, "effects", "effects at a joint", JUDGEMENT)
    tried: int = threshold(30, "candidates", "candidates by which a model is grown", NUMERICS)
    first_tried: int = threshold(60, "candidates", "candidates by which the empty model is grown", NUMERICS)
    edge: float = threshold(
        1e-3, "of the range", "from its bound within which a parameter in use takes up no more", NUMERICS
    )
    prior_candidates: float = threshold(
        40.0,
        "candidates",
        "equally probable effects that a candidate is one of",
        "the catalogue has 33 effects of the arm",
    )
    prior_parameter: float = threshold(1.0, "nats", "price of each further parameter of an effect", JUDGEMENT)
    gain: float = threshold(3.0, "nats", "that an effect must gain beyond its log prior", DEVELOPMENT)
    gain_errors: float = threshold(1.5, "standard errors", "over blocks, that an effect must gain", DEVELOPMENT)
    sure_gain: float = threshold(40.0, "nats", "gain that counts whatever its standard error is", DEVELOPMENT)
    energy_share: float = threshold(
        0.02, "1", "of a stage's held-out squares that an effect must explain to be worth naming", DEVELOPMENT
    )
    tie: float = threshold(2.0, "nats", "within which the model with fewer parameters is preferred", JUDGEMENT)
    rescored: float = threshold(
        200.0, "nats", "behind the best up to which models are scored again with settled shapes", NUMERICS
    )
    tied: int = threshold(4, "widths", "leaders among which a tie is looked for", NUMERICS)


@dataclass(frozen=True)
class Visible:
    """Smallest RMS of a residual that matters (inference/visible.py)."""

    controller: float = threshold(1e-5, "of the torque limit", "of r0, which no sensor blurs", JUDGEMENT)
    drive: float = threshold(1e-4, "of the torque limit", "of r1", JUDGEMENT)
    dynamics: float = threshold(1e-4, "of the torque limit", "of r2", JUDGEMENT)
    friction: float = threshold(
        0.03, "of the joint's friction", "of r2: friction varies by some per cent with posture and day", DEVELOPMENT
    )
    twist: float = threshold(5e-7, "rad", "of r3", "a sixth of the noise of a sample of two encoders of 10 urad")


@dataclass(frozen=True)
class Ranking:
    """Probabilities, and which effects are equivalent on these data (inference/ranking.py)."""

    draws: int = threshold(1000, "draws", "of the Bayesian bootstrap over blocks", NUMERICS)
    leaders: int = threshold(400, "models", "that are given a probability", NUMERICS)
    span: float = threshold(1e-4, "1", "of a column's squares that other columns may leave and still span it", NUMERICS)
    equal: float = threshold(3.0, "nats", "within which two models explain the same", JUDGEMENT)
    equal_most: float = threshold(8.0, "nats", "the same where blocks differ much", JUDGEMENT)


@dataclass(frozen=True)
class Averaging:
    """Bayesian model averaging of intervals (inference/averaging.py)."""

    leaders: int = threshold(60, "groups", "groups of effects that are averaged", NUMERICS)
    weight: float = threshold(1e-3, "1", "smallest weight of a group that counts", NUMERICS)


@dataclass(frozen=True)
class Estimating:
    """Values and intervals of parameters, and nonlinear shapes (inference/estimates.py)."""

    t95: float = threshold(
        2.0, "standard deviations", "half width of a 95 % interval", "normal distribution, rounded up"
    )
    bootstraps: int = threshold(200, "draws", "of the bootstrap over blocks", NUMERICS)
    rounds: int = threshold(5, "rounds", "of the secant method for a shape that is linear to first order", NUMERICS)
    shares: tuple[float, float] = threshold(
        (0.02, 3.0), "1", "coefficients of a shape within which it is moved", JUDGEMENT
    )
    settled_share: float = threshold(
        0.003, "1", "distance of the coefficient from one at which a shape is settled", NUMERICS
    )
    slope: float = threshold(-0.3, "1", "flattest slope that the secant method goes by", NUMERICS)
    longest_step: float = threshold(1.0, "1", "longest step of the logarithm of a shape", NUMERICS)
    steps: int = threshold(12, "steps", "of the line search for any other shape", NUMERICS)
    first_step: float = threshold(0.25, "of the shape", "first step of the line search", NUMERICS)
    narrowing: float = threshold(0.6, "1", "of a step, after one that found nothing better", NUMERICS)
    interval_fall: float = threshold(
        2.0, "nats", "fall of the log likelihood at the ends of a shape's 95 % interval", "Wilks 1938, rounded up"
    )
    parabola_fall: float = threshold(50.0, "nats", "fall within which the log likelihood is a parabola", JUDGEMENT)
    unknown_width: float = threshold(
        0.05, "of the shape", "half width where no point of that parabola is known", JUDGEMENT
    )
    smallest_shape: float = threshold(0.2, "of the shape", "smallest shape that an interval is drawn to", NUMERICS)
