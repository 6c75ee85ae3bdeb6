"""Which of the watchdog's states are told, and when. No ROS."""

from __future__ import annotations

from np_control.safety import State

PASSING = (State.MOVING, State.HOLDING)
TOLD_EVERY = 100_000_000  # ns between two changes from one of them to the other that are told


class StateChangeThrottle:
    """Every change is told at once, but for moving and holding in turn, ten times a second: where commands
    come late all the time, telling it would make more late. A change that comes too early is told as soon as
    its time has come, if it lasts: silence is never told as a stop without the hold that comes before it.
    """

    def __init__(self):
        self._told: tuple[State, str] | None = None
        self._at = 0

    def is_due(self, stamp: int, state: State, cause: str) -> bool:
        """Whether to tell this state now, at `stamp` ns on the driver's clock; it is told then."""
        if (state, cause) == self._told:
            return False
        is_passing = state in PASSING and self._told is not None and self._told[0] in PASSING
        if is_passing and stamp < self._at + TOLD_EVERY:
            return False
        self._told, self._at = (state, cause), stamp
        return True
