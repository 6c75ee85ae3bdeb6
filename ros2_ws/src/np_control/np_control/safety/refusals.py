"""Refusals: every command that is not carried out has a reason and a count."""

from __future__ import annotations

from contextlib import AbstractContextManager
from enum import StrEnum
from math import isfinite

import numpy as np


class Reason(StrEnum):
    """Why a command was refused."""

    NAMES = "names"  # not the seven joints, in order
    LENGTH = "length"  # an array of the wrong length
    NOT_FINITE = "not_finite"  # NaN or infinity
    LATE = "late"  # for a state older than the limit
    FUTURE = "future"  # for a state that was not published yet
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
    HEARTBEAT = "heartbeat"  # the node that owns the phase is silent
    STATE = "state"  # not in a state that takes commands
    NOT_AT_REST = "not_at_rest"  # recovery while the arm still moves


class Refusal(ValueError):
    """A command that must not be carried out: `reason` gives the cause, the text what was expected and what came."""

    def __init__(self, reason: Reason, text: str):
        super().__init__(reason, text)  # args are what a copy in another process is made from
        self.reason = reason

    def __str__(self) -> str:
        return "{}: {}".format(*self.args)


class Refusals:
    """Counts of refusals by reason, and the last one's text, for diagnostics."""

    def __init__(self):
        self.counts = dict.fromkeys(Reason, 0)
        self.last = ""
        self._counting = _Counting(self)

    def add(self, refusal: Refusal) -> None:
        """Count one refusal."""
        self.counts[refusal.reason] += 1
        self.last = str(refusal)

    def counting(self) -> AbstractContextManager[None]:
        """Count a Refusal raised inside, and let it pass."""
        return self._counting

    @property
    def total(self) -> int:
        """All refusals so far."""
        return sum(self.counts.values())

    def nonzero(self) -> dict[str, int]:
        """Counts of the reasons that occurred."""
        return {str(reason): count for reason, count in self.counts.items() if count}


class _Counting:
    """The context of `Refusals.counting`. At 500 Hz a generator would cost half as much as the checks inside."""

    def __init__(self, refusals: Refusals):
        self._refusals = refusals

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind, error, trace) -> None:
        if isinstance(error, Refusal):
            self._refusals.add(error)


def check_finite(**arrays: np.ndarray) -> None:
    """Raise Refusal(not_finite), naming the first array that holds NaN or infinity."""
    for name, array in arrays.items():
        # The sum of squares shows it at a fraction of the cost, but for numbers that overflow it.
        if not isfinite(np.vdot(array, array)) and not np.isfinite(array).all():
            raise Refusal(Reason.NOT_FINITE, f"{name}: expected finite numbers, got {np.asarray(array)}")
