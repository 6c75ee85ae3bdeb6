"""Numeric limits: torque, torque rate, joint speed, soft walls at the joint limits, workspace, gains.

All guards on torque are projections: guarding a guarded torque again, at the same state, changes nothing. So
the controller and the backend can both guard without disturbing each other.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from np_control.impedance import DAMPING_RATIO_MAX, DAMPING_RATIO_MIN, STIFFNESS_MAX, STIFFNESS_MIN
from np_control.safety.refusals import Reason, Refusal, check_finite
from np_description.control_rate import PERIOD_NS
from np_description.panda import NOMINAL, PandaModel

_GAIN_SPAN = np.stack([STIFFNESS_MAX - STIFFNESS_MIN, np.full(7, DAMPING_RATIO_MAX - DAMPING_RATIO_MIN)])
_SIDES = np.array([[-1.0], [1.0]])  # lower and upper


def _constant(*values: float):
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return field(default_factory=lambda: array)


@dataclass(frozen=True, eq=False)
class SafetyLimits:
    """Limits of one arm; arrays have one entry a joint, T_E is in the base frame."""

    joints: tuple[str, ...]
    """Names in order."""
    position_lower: np.ndarray
    """Lower end of the mechanical range, rad."""
    position_upper: np.ndarray
    """Upper end of the mechanical range, rad."""
    velocity: np.ndarray
    """Data sheet's limit, beyond which the arm faults, rad/s."""
    torque: np.ndarray
    """Limit of the torque without gravity, Nm."""
    torque_rate: float
    """Limit of its rate, Nm/s."""
    period_ns: int = PERIOD_NS
    """Control period, ns."""
    speed_fraction: float = 0.8
    """Share of `velocity` that the guards allow, which leaves them room to brake."""
    wall_margin: float = 0.05
    """Distance of the soft wall from the mechanical range, rad."""
    wall_rate: float = 5.0
    """A joint approaches its wall at no more than this times the distance left, 1/s."""
    inertia: np.ndarray = _constant(0.17, 0.56, 0.138, 0.22, 0.11, 0.12, 0.10)
    """Least inertia of a joint when all others are free, 1 / (M^-1)_ii over the whole range, kg m^2; sets how soon torque must fall."""
    workspace_lower: np.ndarray = _constant(0.20, -0.50, -0.06)
    """Lower corner of the box for targets of T_E (3,) m; below the table, since a target that presses lies below its surface."""
    workspace_upper: np.ndarray = _constant(0.80, 0.50, 0.80)
    """Upper corner (3,) m."""
    workspace_slack: float = 0.10
    """A target further outside the box is refused, not clamped, m."""
    gain_slew: float = 50.0
    """The whole range of a gain takes at least 1 / gain_slew seconds, 1/s."""
    start_tolerance: float = 0.10
    """Largest distance of the first joint target from the measured position, rad."""
    press: float = 30.0
    """Force by which a held target or that of a trajectory may make the hand press, N; see `press_force_scale`."""
    rest_speed: float = 0.05
    """Speed below which the arm counts as at rest, rad/s."""
    late_periods: int = 3
    """Periods after which a command is late; see `check_command`."""
    missed_periods: int = 3
    """Missed periods after which the arm holds; see `Watchdog`."""
    silence_ns: int = 200_000_000
    """Time without commands after which the arm stops, ns; see `Watchdog`."""

    @classmethod
    def of(cls, panda: PandaModel, **changes) -> SafetyLimits:
        """The limits of `panda`, with fields changed by keyword."""
        return cls(
            joints=panda.joints,
            position_lower=panda.position_lower,
            position_upper=panda.position_upper,
            velocity=panda.velocity_limit,
            torque=panda.torque_limit,
            torque_rate=panda.torque_rate_limit,
            **changes,
        )

    # What the guards derive from the limits at every period is derived once.

    @cached_property
    def period(self) -> float:
        """The control period in s."""
        return self.period_ns * 1e-9

    @cached_property
    def torque_step(self) -> float:
        """Nm, by which torque may change in a period."""
        return self.torque_rate * self.period

    @cached_property
    def cruise(self) -> np.ndarray:
        """Greatest speed (7,) rad/s that the guards allow."""
        return self.speed_fraction * self.velocity

    @cached_property
    def walls(self) -> np.ndarray:
        """Positions (2, 7) rad of the soft walls, lower and upper."""
        return np.stack([self.wall_lower, self.wall_upper])

    @cached_property
    def wall_lower(self) -> np.ndarray:
        """Position (7,) rad of the lower soft wall."""
        return self.position_lower + self.wall_margin

    @cached_property
    def wall_upper(self) -> np.ndarray:
        """Position (7,) rad of the upper soft wall."""
        return self.position_upper - self.wall_margin

    @cached_property
    def command_lower(self) -> np.ndarray:
        """Least position rad, velocity rad/s and torque Nm (3, 7) of a command."""
        return np.stack([self.position_lower, -self.velocity, -self.torque])

    @cached_property
    def command_upper(self) -> np.ndarray:
        """Greatest position rad, velocity rad/s and torque Nm (3, 7) of a command."""
        return np.stack([self.position_upper, self.velocity, self.torque])

    @cached_property
    def speed_slope(self) -> np.ndarray:
        """Torque (7,) Nms/rad allowed for each rad/s left to a velocity bound that is near."""
        return self.torque / self.cruise

    @cached_property
    def retraction(self) -> np.ndarray:
        """Square of the torque allowed, (7,) Nm^2, for each rad/s left to a velocity bound that is far."""
        return 2 * self.torque_rate * self.inertia


LIMITS = SafetyLimits.of(NOMINAL)


def velocity_bounds(limits: SafetyLimits, q: np.ndarray) -> np.ndarray:
    """Least and greatest velocity (2, ..., 7) rad/s allowed at q (..., 7) rad.

    Far from the walls these are the speed limits; towards a wall they shrink in proportion to the distance,
    so that the approach is exponential; behind the wall they point back out.
    """
    # The pull back from far outside the range is no faster than cruising either.
    walls = limits.walls if q.ndim == 1 else limits.walls.reshape(2, *(1,) * (q.ndim - 1), q.shape[-1])
    return _clip(limits.wall_rate * (walls - q), limits.cruise)


def torque_bounds(limits: SafetyLimits, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest torque (..., 7) Nm allowed at state q (..., 7) rad, dq (..., 7) rad/s.

    Towards a velocity bound the torque may be no more than can be taken back, at the torque rate, before the
    joint reaches the bound (v = tau^2 / (2 rate inertia)); close to the bound it fades linearly, and beyond
    it turns into braking.
    """
    sides = _SIDES if q.ndim == 1 else _SIDES.reshape(2, *(1,) * q.ndim)
    room = sides * (velocity_bounds(limits, q) - dq)
    lower, upper = sides * _torque_towards(limits, room)
    # Braking is owed even where it is hard to take back.
    lower = np.where(upper < 0, np.minimum(lower, upper), lower)
    return lower, np.maximum(lower, upper)


@lru_cache(maxsize=2)
def _bounds_at(limits: SafetyLimits, q: bytes, dq: bytes) -> tuple[np.ndarray, np.ndarray]:
    """`torque_bounds` of one arm, found once where controller and backend guard the same state in one process; raises as `limit_torque`."""
    state = np.frombuffer(q), np.frombuffer(dq)
    check_finite(q=state[0], dq=state[1])
    return torque_bounds(limits, *state)


def _torque_towards(limits: SafetyLimits, room: np.ndarray) -> np.ndarray:
    """Greatest torque (2, 7) Nm towards velocity bounds `room` (2, 7) rad/s away (negative: exceeded)."""
    retractable = np.sqrt(limits.retraction * np.maximum(room, 0.0))
    return _clip(np.minimum(limits.speed_slope * room, retractable), limits.torque)


def _clip(values: np.ndarray, bound: np.ndarray) -> np.ndarray:
    # numpy.clip costs several times its two halves, which matters at 500 Hz.
    return np.maximum(np.minimum(values, bound), -bound)


def clamp_torque(limits: SafetyLimits, torque: np.ndarray) -> np.ndarray:
    """Torque (7,) Nm within the torque limits."""
    return _clip(torque, limits.torque)


def limit_torque(
    limits: SafetyLimits, torque: np.ndarray, previous: np.ndarray, q: np.ndarray, dq: np.ndarray
) -> tuple[np.ndarray, list[str]]:
    """Torque (..., 7) Nm that may be applied now, and the names of the guards that changed it, of one arm or
    many.

    torque: commanded; previous: applied one period ago, within the limits; q rad, dq rad/s: measured, finite.
    Walls and speed come first, then the torque limit, then the rate, which therefore always holds: a faster
    jump would trip the real robot. Raises Refusal(not_finite).
    """
    check_finite(torque=torque)
    if q.ndim == 1:
        lower, upper = _bounds_at(limits, np.asarray(q, float).tobytes(), np.asarray(dq, float).tobytes())
    else:
        check_finite(q=q, dq=dq)
        lower, upper = torque_bounds(limits, q, dq)
    lawful = clamp_torque(limits, torque)
    guarded = np.minimum(np.maximum(lawful, lower), upper)
    step = limits.torque_step
    slewed = np.minimum(np.maximum(guarded, previous - step), previous + step)
    if not np.count_nonzero(slewed != torque):
        return slewed, []
    stages = (("torque", torque, lawful), ("wall_or_speed", lawful, guarded), ("torque_rate", guarded, slewed))
    return slewed, [name for name, before, after in stages if np.count_nonzero(before != after)]


def limit_target(limits: SafetyLimits, position: np.ndarray) -> tuple[np.ndarray, bool]:
    """T_E target (3,) m within the workspace box, and whether it was clamped.

    Raises Refusal(not_finite), or Refusal(workspace) for a target further than `workspace_slack` outside.
    """
    check_finite(target=position)
    inside = np.clip(position, limits.workspace_lower, limits.workspace_upper)
    distance = np.linalg.norm(position - inside)
    if distance > limits.workspace_slack:
        raise Refusal(
            Reason.WORKSPACE,
            f"target {np.round(position, 3)} m is {distance:.3f} m outside the "
            f"workspace {limits.workspace_lower} to {limits.workspace_upper} m",
        )
    return inside, bool(distance > 0)


def limit_gains(stiffness: np.ndarray, ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness (7,) Nm/rad and damping ratio (7,), cut to their bounds where rounding put them outside.

    Raises Refusal(not_finite), or Refusal(gains) for a gain more than 0.1 % of its range outside.
    """
    check_finite(stiffness=stiffness, damping_ratio=ratio)
    bounded = []
    for name, gain, least, most in (
        ("stiffness", stiffness, STIFFNESS_MIN, STIFFNESS_MAX),
        ("damping ratio", ratio, DAMPING_RATIO_MIN, DAMPING_RATIO_MAX),
    ):
        inside = np.clip(gain, least, most)
        if (np.abs(inside - gain) > 1e-3 * (np.asarray(most) - least)).any():
            raise Refusal(Reason.GAINS, f"{name}: expected {least} to {most}, got {gain}")
        bounded.append(inside)
    return bounded[0], bounded[1]


def slew_gains(limits: SafetyLimits, current: np.ndarray, target: np.ndarray, dt: float) -> np.ndarray:
    """Gains (2, 7), rows stiffness and damping ratio, moved from `current` towards `target` over dt s."""
    step = limits.gain_slew * dt * _GAIN_SPAN
    return np.minimum(np.maximum(target, current - step), current + step)
