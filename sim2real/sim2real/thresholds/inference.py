"""Thresholds of the inference: rows, blocks, the search for a model, and what is reported of it.

Tolerances of a solver stand beside the solver. Without another source a number is engineering judgement, tried on the
opened cases of the sealed test.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Rows:
    """Which rows of a recording count at which stage (`inference.residual_stages`)."""

    standstill: float = 0.02
    """rad/s, largest speed at which a joint does not count as sliding."""
    slowest: float = 0.002
    """rad/s, speed below which a joint may stand still at a reversal."""
    kink: float = 0.02
    """rad/s^2, jump of the target's acceleration beyond which the feedforward torque is unknown."""
    guard: float = 1e-6
    """Nm from a bound of the controller's guards at which a command is cut."""
    kink_margin: int = 4
    """Periods left out on either side of a gap in the commands."""


@dataclass(frozen=True)
class Blocks:
    """Cross-validation: how a recording is cut, and prewhitening (`inference.residual_cells`)."""

    least: int = 10
    """Smallest number of blocks of a recording."""
    duration: float = 3.0
    """s, length of a block of a long recording."""
    gap: float = 0.5
    """s left out of training on either side of a block."""
    gaps_per_block: float = 3.0
    """Length in gaps of the shortest block that can be predicted."""
    rows: int = 8
    """Smallest number of rows with which a block counts in a cell."""
    order: int = 2
    """Order of the autoregression that whitens residuals (Cochrane and Orcutt 1949)."""
    order_rows: int = 50
    """Smallest number of rows from which an autoregression is estimated."""
    order_ridge: float = 1e-3
    """Ridge of the Yule-Walker equations, relative to the variance."""

    @property
    def shortest(self) -> float:
        """s of motion from which a recording can be cut into as many blocks."""
        return self.least * self.gaps_per_block * self.gap


@dataclass(frozen=True)
class LoopDelay:
    """The delay of the control loop, estimated before the search (`inference.loop_delay`)."""

    prior: float = 3e-3
    """s, prior standard deviation of the delay."""
    longest: float = 30.0
    """Longest delay that is considered, in prior standard deviations."""
    command_spread: float = 2e-5
    """s by which the delay of commands differs between joints."""
    motion_spread: float = 1.5e-4
    """s by which noise of the velocity imitates a delay of the motion."""


@dataclass(frozen=True)
class Nuisances:
    """Random effects that every arm has and no prediction models (`inference.nuisances`)."""

    delay: float = 2e-4
    """s, usual delay between command and torque."""
    delay_spread: float = 1.5e-4
    """s, its standard deviation."""
    delay_between: float = 5e-5
    """s, standard deviation of its change between two recordings: clocks start at a new phase."""
    loose_delay_spread: float = 1e-3
    """s, the same without commands: torque and motion may have clocks of their own."""
    breakaways: tuple[float, float, float] = (1e-4, 2e-4, 5e-4)
    """rad over which friction builds up after a reversal."""
    breakaway_spread: float = 0.7
    """Standard deviation of the share of the nominal friction that builds up late."""
    late_breakaway_spread: float = 1.0
    """The same over the longer distances."""
    friction: float = 0.015
    """Relative standard deviation of a joint's friction; up to 0.05 is no fault."""
    damping: float = 0.03
    """The same of its damping."""
    uneven: float = 0.05
    """Standard deviation of the waves of friction over the angle."""
    uneven_orders: tuple[float, ...] = (1.5, 3.0)
    """1/rad, orders of those waves: between them they span one to three a turn."""
    zero_spread: float = 0.01
    """rad, standard deviation of the zero of a motor's encoder."""
    acceleration_error: float = 0.001
    """Relative error of a filtered acceleration of a motion without noise."""
    noise_share: float = 0.1
    """Largest share of a measured acceleration that is noise (Fuller, Measurement Error Models, 1987)."""
    link_torque: float = 1.5e-5
    """RMS below which a component of the links' errors is invisible, relative to the torque limit."""
    gear_yield: float = 1e-5
    """rad/Nm, compliance of the stiffest gears."""


@dataclass(frozen=True)
class Hints:
    """What a recording suggests should be looked for (`inference.context`)."""

    ripples: int = 2
    """Orders of torque ripple that are tried in a joint."""
    orders: tuple[int, int] = (20, 400)
    """1/rad, range of orders."""
    order_distance: int = 2
    """1/rad within which two orders are one line of the spectrum."""
    ripple_speed: float = 0.02
    """rad/s, speed from which a row counts for the spectrum."""
    ripple_rows: int = 200
    """Smallest number of rows of a spectrum."""
    play: float = 1e-5
    """rad, motion of a smoothed twist that may be noise."""
    more_lost: float = 3.0
    """Standard errors by which more packets are lost than before."""
    always_wound: float = 0.04
    """Share of a straight gear's residual twist that hysteresis removes in the earlier recording of an arm that always
    had it; six arms with it or a soft gear: 0.07 to 0.96, others: up to 0.02."""
    same_step: float = 0.05
    """Relative difference of an encoder's step that counts as none."""


@dataclass(frozen=True)
class Searching:
    """Which models are tried, and when an effect is added (`inference.search`)."""

    per_joint: int = 2
    """Largest number of effects at a joint."""
    tried: int = 30
    """Number of candidates by which a model is extended."""
    prior_candidates: float = 40.0
    """Equally probable effects among which a candidate is drawn; the catalogue has 33 of the arm."""
    prior_parameter: float = 1.0
    """nats, price of each further parameter of an effect."""
    gain: float = 3.0
    """nats that an effect must gain beyond its log prior."""
    gain_errors: float = 1.5
    """Standard errors over blocks that an effect must gain."""
    sure_gain: float = 40.0
    """nats of gain that count whatever the standard error."""
    energy_share: float = 0.02
    """Share of a stage's held-out squares that an effect must explain to be reported."""
    tie: float = 2.0
    """nats within which the model with fewer parameters is preferred."""


@dataclass(frozen=True)
class Visible:
    """Smallest RMS of a residual that matters (`inference.noise_floor`)."""

    controller: float = 1e-5
    """Of the controller's residual, which no sensor blurs; relative to the torque limit."""
    drive: float = 1e-4
    """Of the drive's residual; relative to the torque limit."""
    dynamics: float = 1e-4
    """Of the dynamics residual; relative to the torque limit."""
    friction: float = 0.03
    """The same, relative to the joint's friction, which varies by some per cent with posture and day."""
    twist: float = 5e-7
    """rad, of the twist: a sixth of the noise of a sample of two encoders of 10 urad."""


@dataclass(frozen=True)
class Ranking:
    """Which effects are equivalent on these data (`inference.ranking`)."""

    equal: float = 3.0
    """nats within which two models explain the same."""
    equal_most: float = 8.0
    """The same where blocks differ much."""


@dataclass(frozen=True)
class Estimating:
    """Values and intervals of parameters, and nonlinear shapes (`inference.estimates`)."""

    t95: float = 2.0
    """Standard deviations of half a 95 % interval."""
    shares: tuple[float, float] = (0.02, 3.0)
    """Range of a shape's coefficient within which the shape is moved."""
    interval_fall: float = 2.0
    """nats, fall of the log likelihood at the ends of a shape's 95 % interval (Wilks 1938)."""
    parabola_fall: float = 50.0
    """nats, fall within which the log likelihood is a parabola."""
    unknown_width: float = 0.05
    """Relative half width where no point of that parabola is known."""
