"""Which of the watchdog's states are reported, and when. No ROS."""

from __future__ import annotations

from np_control.safety import State

PASSING = (State.MOVING, State.HOLDING)
REPORTED_EVERY = 100_000_000  # ns between two changes from one of them to the other that are reported


class StateChangeThrottle:
    """Every change is reported at once. Changes between moving and holding are reported at most ten times a second:
    where commands come late all the time, reporting each would make more late. A change that comes too early is
    reported as soon as its time has come, if it lasts: silence is never reported as a stop without the hold before it.
    """

    def __init__(self):
        self._reported: tuple[State, str] | None = None
        self._at = 0

    def is_due(self, stamp: int, state: State, cause: str) -> bool:
        """Whether to report this state now, at `stamp` ns on the driver's clock; True counts as reported."""
        if (state, cause) == self._reported:
            return False
        is_passing = state in PASSING and self._reported is not None and self._reported[0] in PASSING
        if is_passing and stamp < self._at + REPORTED_EVERY:
            return False
        self._reported, self._at = (state, cause), stamp
        return True
