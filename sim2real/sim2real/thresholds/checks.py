"""Thresholds of the checks: what a recording must satisfy, and when a model is no explanation.

Without another source a number is engineering judgement, tried on the opened cases of the sealed test.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Recordings:
    """What a recording must be (`recordings`)."""

    period_tolerance: float = 0.05
    """Largest relative deviation of the period of joint states."""
    rates: tuple[float, float] = (45.0, 10000.0)
    """Hz, lowest and highest rate of a recording that states none; outside, its times are not in seconds."""
    answer: float = 0.5
    """Periods by which the state after a command may be late or early."""
    command_gap: float = 1.5
    """Periods between commands from which a new stretch begins."""
    loss: float = 0.02
    """Largest share of missing joint states."""
    largest_gap: float = 0.05
    """s without data over which signals are interpolated."""
    shortest: float = 1.0
    """s, shortest stretch without a gap that is used."""
    stretch: float = 6.0
    """s, length of an excerpt for a quick look: two blocks of the cross-validation."""
    short: float = 45.0
    """s, total length of the excerpts: 3 to 4 s of computation on two cores."""
    with_gains: float = 0.5
    """Least share of commands after the first gains for which the controller's law is replayed."""
    held_load: float = 0.1
    """Nm by which a joint that is not named may change the torques that hold the arm: above a finger's."""
    speed_lag: float = 0.01
    """s by which a reported speed may lag behind its position: a Panda and a UR5 report it 5 ms late."""
    speed_lag_error: float = 0.002
    """s, largest standard error of a lag that is used."""


@dataclass(frozen=True)
class ControlLoop:
    """When the timing of a control loop is disturbed or broken, and why (`checks.control_loop`)."""

    cycle: float = 1e-3
    """s, control cycle of a Franka."""
    in_a_row: int = 20
    """Lost cycles in a row after which the robot ends the motion (FCI documentation, "Network bandwidth, delay and jitter test")."""
    success: float = 0.95
    """Mean `control_command_success_rate` below which libfranka's `communication_test` reports that many packets got lost."""
    reply: float = 0.5e-3
    """s from a state to its command that are left of a cycle beside the network, whose round trip may take as long (FCI documentation)."""
    lost: float = 1e-3
    """Share of cycles whose loss is a disturbance."""
    burst: int = 5
    """Lost cycles in a row that are one."""
    late: float = 0.01
    """Share of late or missing commands, targets and recorded states that is a disturbance; a smaller `packet_loss` is not found either."""
    accounted: float = 0.5
    """Share of the lost time that a cause must account for."""
    settled: float = 2.5
    """s after which the diagnostics, once a second, have counted a loss; a longer pause between two of them leaves the loop unknown."""
    covered: float = 0.8
    """Share of a recording that diagnostics must cover before a loop counts as steady."""
    pause: float = 1.0
    """s without targets that are a pause of the policy."""


@dataclass(frozen=True)
class Plausibility:
    """Units, signs and order of joints (`checks.plausibility`)."""

    range_slack: float = 0.05
    """rad by which a position may exceed the joint limits."""
    speed_slack: float = 1.5
    """Factor by which a joint may exceed its speed limit."""
    speed_percentile: float = 75.0
    """Per cent of the time in which a joint keeps its speed limit (a swinging wrist: development case, seed 11)."""
    rows: int = 300
    """Number of samples on which the dynamics are tried."""
    decisive: float = 3.0
    """nats by which other units, signs or names must reduce a joint's log residual."""
    slope: tuple[float, float] = (0.7, 1.4)
    """Range of the position's derivative over the velocity: a factor of sqrt(2) to either side."""
    velocity_step: float = 0.01
    """s over which positions are differentiated."""
    torque_error: float = 1e-3
    """Error of a torque that is accepted, relative to the torque limit."""


@dataclass(frozen=True)
class Effort:
    """Which torque is measured (`checks.effort_side`)."""

    share: float = 0.4
    """Share of the nominal friction, or of the rotors, below which a torque contains none of it."""
    apart: float = 0.1
    """Smallest share of a rotor's torque that resembles no other torque; below it, the rotor is not determined."""
    rows: int = 100
    """Smallest number of samples in which a joint slides."""
    smooth: int = 9
    """Number of samples over which the speed is averaged."""


@dataclass(frozen=True)
class Current:
    """Torque constants of motors from a recording (`recordings.motor_current`, `inference.torque_constants`)."""

    rows: int = 100
    """Smallest number of samples in which a joint slides."""
    sure: float = 0.1
    """Largest relative standard error of a constant that is used."""
    known: float = 0.02
    """Relative error of the weights that determine a constant."""
    spread: float = 0.3
    """Relative error of a first estimate by effects that are not known yet."""
    refined: float = 3.0
    """Factor of a change by effects from which a constant is not determined: wrist 1 of a public UR5 log."""
    settled: float = 0.003
    """Relative change at which the iteration ends."""
    rounds: int = 3
    """Largest number of alternations between constants and effects."""


@dataclass(frozen=True)
class Floor:
    """How well the data repeat (`checks.repeatability`)."""

    distance: float = 1.0
    """s between two passes through the same state, at least."""
    near_position: float = 0.02
    """rad within which two states of a joint are the same."""
    near_velocity: float = 0.05
    """rad/s, likewise."""
    near_acceleration: float = 0.3
    """rad/s^2, likewise."""
    pairs: int = 40
    """Smallest number of pairs of passes from which the floor is measured."""


@dataclass(frozen=True)
class Shrinkage:
    """How far the gap shrinks, and where (`checks.shrinkage`, `report.document`)."""

    bootstraps: int = 300
    """Draws of the bootstrap over blocks."""
    blocks: int = 3
    """Smallest number of blocks in which a joint must move to be judged."""
    standing: float = 0.02
    """rad/s, largest speed of a joint at standstill."""
    fast: float = 0.3
    """rad/s, smallest speed of a fast joint."""
    accelerating: float = 2.0
    """rad/s^2, smallest acceleration of an accelerating joint."""
    twist_weight: float = 1e8
    """Nm^2/rad^2, weight of a squared twist beside a squared torque: 0.1 mrad counts as 1 Nm."""
    worse: float = 1.05
    """Factor of growth from which the gap of a regime is reported as worse."""


@dataclass(frozen=True)
class HeldOutMotion:
    """Motion that is laid aside before fit and choice (checks/held_out.py)."""

    window: float = 1.5
    """s, of a window that is laid aside: two shots of the simulator."""
    every: float = 7.5
    """s, from one window to the next: a fifth of the motion is laid aside."""
    shortest: float = 45.0
    """s, of recordings of which any is laid aside: the rest is fitted to."""
    shown: float = 0.05
    """Share of what an effect does elsewhere that it must do in the windows to be judged there."""
    bootstraps: int = 1000
    """Draws of the bootstrap over windows."""


@dataclass(frozen=True)
class Omnibus:
    """The omnibus test of lack of fit by a flexible model (`checks.lack_of_fit`)."""

    harmonics: int = 6
    """Harmonics of the joint's angle in the flexible model."""
    direction_speed: float = 0.01
    """rad/s at which the direction of motion is certain at the controller's rate."""
    outlying: float = 5.0
    """Standard deviations from which a value is no noise: one of two million values of a normal distribution."""
    blocks: int = 4
    """Smallest number of blocks on which a cell is tested."""


@dataclass(frozen=True)
class Verdict:
    """From the model and its lack of fit to the verdict (`diagnosis`, `checks.unexplained`)."""

    certain: float = 0.8
    """Probability from which an effect counts as identified."""
    explained: float = 0.8
    """Share of what is predictable at all that a model must explain."""
    gain: float = 25.0
    """nats by which the flexible model must predict better."""
    gain_errors: float = 2.0
    """The same in standard errors over blocks."""
    coloured: float = 1.5
    """Ratio of a dynamics residual to its white part from which it is no noise."""
    coloured_explained: float = 0.9
    """Share of what is no white noise that a model must explain."""
    torque: float = 0.0005
    """RMS below which nothing is left, relative to the torque limit."""
    quantum: float = 2e-5
    """rad, smallest encoder step that is reported."""
    quantum_error: float = 0.01
    """Half width of its interval, relative to the step."""
    per_joint: int = 2
    """Largest number of effects that explain a joint, effects of the arm included."""
    needed: float = 0.05
    """Share of a stage's squares that is left over without an effect that is needed."""
    at_bound: float = 0.98
    """Share of its bound from which a parameter is at the bound."""
    listed_probability: float = 0.02
    """Probability from which an alternative is listed."""
    listed: int = 8
    """Number of findings beyond which no alternative is listed."""


@dataclass(frozen=True)
class Constancy:
    """Whether an effect has one size, and the twist follows the load alone (`checks.stationarity`)."""

    gain: float = 60.0
    """nats by which the columns of a question must predict better."""
    gain_errors: float = 1.5
    """The same in standard errors over blocks: what changes with time is in some blocks only."""
    of_left: float = 0.15
    """Share of the squares that the model leaves."""
    of_null: float = 0.003
    """Share of the squares without any effect: the law of an effect is wrong by up to a twentieth of its size."""
    torque: float = 0.0002
    """Smallest RMS that matters, relative to the torque limit."""
    twist: float = 3e-5
    """rad, smallest RMS of a twist that matters."""
    blocks: int = 4
    """Smallest number of blocks of a cell."""
    lags: tuple[int, ...] = (1, 2, 3, 4, 6, 8)
    """Samples by which a memory of the acceleration may lag: up to a third of a second."""
    slip_window: float = 10.0
    """s on either side of a jump between the encoders."""
    slip_samples: int = 10
    """Smallest number of samples on either side of a jump."""
    slip_lasting: float = 10.0
    """Ratio of a lasting jump to the deviations on either side."""
    slip_quantile: float = 0.9
    """Share of the samples that stay within those deviations."""
    slip_steps: int = 2
    """Samples on either side within which a jump is complete."""
    slip_share: float = 0.7
    """Share of a jump that comes at once."""


@dataclass(frozen=True)
class Standstill:
    """Friction that depends on the time at rest (`checks.friction_ageing`)."""

    still: float = 0.005
    """rad/s, largest speed at rest."""
    shortest: float = 0.06
    """s, shortest rest; anything shorter is a reversal or noise."""
    fade: float = 0.08
    """s, time constant of the memory of a rest once the joint moves."""
    long: float = 0.5
    """s from which a rest is long."""
    share: float = 0.2
    """Share of the squares left at reversals that the time at rest explains (a clean arm: below 0.01)."""
    torque: float = 0.00025
    """Smallest RMS that matters, relative to the torque limit."""
    fresh: float = 0.3
    """Memory of a rest from which a row counts as shortly after it."""
    rows: int = 10
    """Smallest number of rows shortly after a rest."""
