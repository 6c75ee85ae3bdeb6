"""Validation of commands: names, lengths, values, limits, stamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from np_control.safety.limits import SafetyLimits
from np_control.safety.refusals import Reason, Refusal, check_finite


@dataclass(frozen=True)
class Command:
    """One validated effort command.

    stamp: ns, of the state it answers; position (7,) rad, velocity (7,) rad/s: joint target; effort (7,) Nm.
    """

    stamp: int
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray


def check_command(
    limits: SafetyLimits,
    stamp: int,
    names: Sequence[str],
    position: Sequence[float],
    velocity: Sequence[float],
    effort: Sequence[float],
    *,
    now: int,
    last: int | None = None,
) -> Command:
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
            raise Refusal(Reason.LENGTH, f"{name}: expected {len(limits.joints)} values, got {arrays[name].size}")
    check_finite(**arrays)
    if stamp > now:
        raise Refusal(Reason.FUTURE, f"stamp {stamp} ns is after the newest state, {now} ns")
    if last is not None and stamp < last:
        raise Refusal(Reason.ORDER, f"stamp {stamp} ns is before the last command's, {last} ns")
    if now - stamp > limits.late_periods * limits.period_ns:
        raise Refusal(
            Reason.LATE,
            f"stamp {stamp} ns is {(now - stamp) / limits.period_ns:.0f} periods old, "
            f"allowed are {limits.late_periods}",
        )
    _check_range(limits, Reason.POSITION, "rad", arrays["position"], limits.position_lower, limits.position_upper)
    _check_range(limits, Reason.VELOCITY, "rad/s", arrays["velocity"], -limits.velocity, limits.velocity)
    _check_range(limits, Reason.TORQUE, "Nm", arrays["effort"], -limits.torque, limits.torque)
    return Command(stamp, arrays["position"], arrays["velocity"], arrays["effort"])


def _check_range(
    limits: SafetyLimits, reason: Reason, unit: str, values: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> None:
    outside = (values < lower) | (values > upper)
    if outside.any():
        i = int(outside.argmax())
        raise Refusal(reason, f"{limits.joints[i]}: expected {lower[i]} to {upper[i]} {unit}, got {values[i]}")
