"""Validation of commands: names, lengths, values, limits, stamps. Every refusal has a reason and a count."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from np_control.safety.limits import SafetyLimits


class Reason(StrEnum):
    """Why a command was refused."""

    NAMES = "names"  # not the seven joints, in order
    LENGTH = "length"  # an array of the wrong length
    NOT_FINITE = "not_finite"  # NaN or infinity
    LATE = "late"  # answers a state older than the limit
    FUTURE = "future"  # answers a state that was not published yet
    ORDER = "order"  # older than the command before it
    POSITION = "position"  # joint target outside the joint's range
    VELOCITY = "velocity"  # joint target faster than the joint's limit
    TORQUE = "torque"  # torque over the limit
    WORKSPACE = "workspace"  # T_E target far outside the box
    GAINS = "gains"  # stiffness or damping outside their bounds
    UNPAIRED = "unpaired"  # a target pose without gains
    UNREACHABLE = "unreachable"  # a target pose that inverse kinematics cannot meet
    TRAJECTORY = "trajectory"  # malformed trajectory
    START = "start"  # first joint target is not the measured position
    STATE = "state"  # not in a state that takes commands
    NOT_AT_REST = "not_at_rest"  # recovery while the arm still moves


class Refusal(ValueError):
    """A command that must not be carried out: `reason` says why, the text what was expected and what came."""

    def __init__(self, reason: Reason, text: str):
        super().__init__(f"{reason}: {text}")
        self.reason = reason


class Refusals:
    """Counts of refusals by reason, and the last one's text, for diagnostics."""

    def __init__(self):
        self.counts = dict.fromkeys(Reason, 0)
        self.last = ""

    def add(self, refusal: Refusal) -> None:
        """Count one refusal."""
        self.counts[refusal.reason] += 1
        self.last = str(refusal)

    @contextmanager
    def counting(self) -> Iterator[None]:
        """Count a Refusal raised inside, and let it pass."""
        try:
            yield
        except Refusal as refusal:
            self.add(refusal)
            raise

    @property
    def total(self) -> int:
        """All refusals so far."""
        return sum(self.counts.values())

    def nonzero(self) -> dict[str, int]:
        """Counts of the reasons that occurred."""
        return {str(reason): count for reason, count in self.counts.items() if count}


@dataclass(frozen=True)
class Command:
    """One validated effort command.

    stamp: ns, of the state it answers; position (7,) rad, velocity (7,) rad/s: joint target; effort (7,) Nm.
    """

    stamp: int
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray


def check_finite(**arrays: np.ndarray) -> None:
    """Raise Refusal(not_finite), naming the first array that holds NaN or infinity."""
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise Refusal(Reason.NOT_FINITE, f"{name}: expected finite numbers, got {np.asarray(array)}")


def check_command(limits: SafetyLimits, stamp: int, names: Sequence[str], position: Sequence[float],
                  velocity: Sequence[float], effort: Sequence[float], *, now: int,
                  last: int | None = None) -> Command:
    """The command with these fields of a JointState, or Refusal.

    stamp: ns, of the state answered; now: ns, stamp of the newest published state; last: ns, stamp of the
    last accepted command. Answering the same state twice is allowed. Position rad, velocity rad/s, effort Nm.
    """
    if tuple(names) != limits.joints:
        raise Refusal(Reason.NAMES, f"expected {list(limits.joints)}, got {list(names)}")
    arrays = {}
    for name, values in (("position", position), ("velocity", velocity), ("effort", effort)):
        arrays[name] = np.array(values, dtype=float)
        if arrays[name].shape != (len(limits.joints),):
            raise Refusal(Reason.LENGTH, f"{name}: expected {len(limits.joints)} values, "
                                         f"got {arrays[name].size}")
    check_finite(**arrays)
    if stamp > now:
        raise Refusal(Reason.FUTURE, f"stamp {stamp} ns is after the newest state, {now} ns")
    if last is not None and stamp < last:
        raise Refusal(Reason.ORDER, f"stamp {stamp} ns is before the last command's, {last} ns")
    if now - stamp > limits.late_periods * limits.period_ns:
        raise Refusal(Reason.LATE, f"stamp {stamp} ns is {(now - stamp) / limits.period_ns:.0f} periods old, "
                                   f"allowed are {limits.late_periods}")
    _check_range(limits, Reason.POSITION, "rad", arrays["position"], limits.position_lower,
                 limits.position_upper)
    _check_range(limits, Reason.VELOCITY, "rad/s", arrays["velocity"], -limits.velocity, limits.velocity)
    _check_range(limits, Reason.TORQUE, "Nm", arrays["effort"], -limits.torque, limits.torque)
    return Command(stamp, arrays["position"], arrays["velocity"], arrays["effort"])


def _check_range(limits: SafetyLimits, reason: Reason, unit: str, values: np.ndarray, lower: np.ndarray,
                 upper: np.ndarray) -> None:
    outside = np.flatnonzero((values < lower) | (values > upper))
    if outside.size:
        i = outside[0]
        raise Refusal(reason, f"{limits.joints[i]}: expected {lower[i]} to {upper[i]} {unit}, "
                              f"got {values[i]}")
