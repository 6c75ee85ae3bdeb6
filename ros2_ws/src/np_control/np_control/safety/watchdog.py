"""The state machine of a backend: who may move the arm, what happens in silence, how to come back.

           start            command
    idle ----------> ready ----------> moving <------ command ------ holding
                       ^                  |  3 missed periods ---------^ |
                       | recover          |                              | 200 ms
                       |                  v stop, fault                  v
                    stopped, fault <------+-------------- (silence) stopped

`stop` wins over everything, in every state; a fault after a stop stays a stop. Only `recover` leads out of
either.
"""

from __future__ import annotations

from enum import StrEnum

from np_control.safety.limits import SafetyLimits
from np_control.safety.refusals import Reason, Refusal


class State(StrEnum):
    """States of a backend."""

    IDLE = "idle"  # no arm: nothing is applied
    READY = "ready"  # holds the measured pose, waits for the first command
    MOVING = "moving"  # follows commands
    HOLDING = "holding"  # commands missed: holds the last joint target
    STOPPED = "stopped"  # stopped on request or after silence: damped to rest
    FAULT = "fault"  # something broke: damped to rest


MAY_MOVE = (State.READY, State.MOVING, State.HOLDING)


class Watchdog:
    """Transitions between the states. Times: ns on the backend's clock; `cause`: what led to the state."""

    def __init__(self, limits: SafetyLimits):
        self._limits = limits
        self._last = 0
        self.state = State.IDLE
        self.cause = "not started"

    @property
    def may_move(self) -> bool:
        """Whether commands are taken and the arm is held or moved."""
        return self.state in MAY_MOVE

    def start(self) -> None:
        """The arm stands at a new pose: wait for the first command. Refusal(state) after a stop or fault."""
        if self.state in (State.STOPPED, State.FAULT):
            raise Refusal(Reason.STATE, f"cannot start: {self.state} ({self.cause}); recover first")
        self._enter(State.READY, "started")

    def check_may_move(self) -> None:
        """Raise Refusal(state) in a state that takes no commands."""
        if not self.may_move:
            raise Refusal(Reason.STATE, f"no commands taken: {self.state} ({self.cause})")

    def command(self, now: int) -> None:
        """A valid command was accepted at `now`. Raises Refusal(state) in a state that takes none."""
        self.check_may_move()
        self._last = now
        self._enter(State.MOVING, "commanded")

    def poll(self, now: int) -> State:
        """The state at `now`, after the deadlines for commands."""
        if self.state in (State.MOVING, State.HOLDING):
            silence = now - self._last
            if silence >= self._limits.silence_ns:
                self._enter(State.STOPPED, f"silence: no command for {silence / 1e6:.0f} ms")
            elif silence > self._limits.missed_periods * self._limits.period_ns:
                # The same text as long as it lasts: a new cause is reported at once.
                allowed = self._limits.missed_periods * self._limits.period_ns / 1e6
                self._enter(State.HOLDING, f"missed: no command for more than {allowed:.0f} ms")
        return self.state

    def stop(self, cause: str = "stop requested") -> None:
        """Damp to rest now, from any state."""
        self._enter(State.STOPPED, cause)

    def fault(self, cause: str) -> None:
        """Damp to rest because something broke; the first cause is kept, and a stop stays a stop."""
        if self.state not in (State.STOPPED, State.FAULT):
            self._enter(State.FAULT, cause)

    def recover(self, at_rest: bool) -> None:
        """Change from stopped or fault to ready. Refusal: not_at_rest while the arm moves, state elsewhere."""
        if self.state not in (State.STOPPED, State.FAULT):
            raise Refusal(Reason.STATE, f"nothing to recover from: {self.state}")
        if not at_rest:
            raise Refusal(Reason.NOT_AT_REST, "the arm still moves")
        self._enter(State.READY, "recovered")

    def _enter(self, state: State, cause: str) -> None:
        self.state, self.cause = state, cause
