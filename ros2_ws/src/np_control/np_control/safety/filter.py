"""The safety filter: guards and watchdog in two calls a period, `offer` and `apply`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from np_control.impedance import STIFFNESS_MAX
from np_control.impedance import torque as impedance_torque
from np_control.safety.commands import Command, check_command
from np_control.safety.limits import LIMITS, SafetyLimits, limit_torque
from np_control.safety.refusals import Reason, Refusal, Refusals, check_finite
from np_control.safety.watchdog import State, Watchdog

HOLD_STIFFNESS = STIFFNESS_MAX
HOLD_DAMPING_RATIO = np.full(7, 1.5)
REST_DAMPING = np.array([40.0, 40.0, 40.0, 40.0, 8.0, 8.0, 8.0])  # Nms/rad


@dataclass(frozen=True)
class AppliedCommand:
    """The command that the backend applies, with gravity compensation on top."""

    state: State
    """State of the watchdog."""
    position: np.ndarray
    """Joint target (7,) rad."""
    velocity: np.ndarray
    """Velocity of the joint target (7,) rad/s."""
    torque: np.ndarray
    """Torque (7,) Nm, without gravity."""
    limited: tuple[str, ...]
    """Names of the guards that changed the torque."""


class SafetyFilter:
    """Guards one arm. Each period: `offer` every command that came, then `apply` with the newest measured
    state.

    Times are ns on the backend's clock (in lockstep the stamp of the state). `refusals` counts refused
    commands, `limited` counts periods in which a guard changed the torque.
    """

    def __init__(self, limits: SafetyLimits = LIMITS):
        self.limits = limits
        self.watchdog = Watchdog(limits)
        self.refusals = Refusals()
        self.limited = {"wall_or_speed": 0, "torque": 0, "torque_rate": 0}
        self._torque = np.zeros(len(limits.joints))
        self._target = np.zeros(len(limits.joints))
        self._dq = np.full(len(limits.joints), np.inf)
        self._command: Command | None = None

    @property
    def state(self) -> State:
        """State of the watchdog."""
        return self.watchdog.state

    @property
    def at_rest(self) -> bool:
        """Whether the last measured state was finite and slower than `rest_speed`."""
        return bool((np.abs(self._dq) < self.limits.rest_speed).all())

    @property
    def is_slack(self) -> bool:
        """Whether the arm is at rest, and what torque is left on it can be taken off in one period."""
        return self.at_rest and bool((np.abs(self._torque) <= self._step).all())

    def start(self, q: np.ndarray) -> None:
        """The arm stands at the measured q (7,) rad: hold it there and wait for commands (start-up, reset).

        Raises Refusal, counted: not_finite, or state after a stop or fault, which takes `recover`.
        """
        with self.refusals.counting():
            check_finite(q=q)
            self.watchdog.start()
        self._torque = np.zeros(len(self.limits.joints))
        self._hold(q)

    def offer(
        self,
        stamp: int,
        names: Sequence[str],
        position: Sequence[float],
        velocity: Sequence[float],
        effort: Sequence[float],
        now: int,
    ) -> None:
        """Take a command, given as the fields of its JointState, to be applied from the next `apply` on.

        Raises Refusal, counted, and leaves everything as it was, where the command must not be carried out.
        """
        with self.refusals.counting():
            self.watchdog.check_may_move()
            last = None if self._command is None else self._command.stamp
            command = check_command(self.limits, stamp, names, position, velocity, effort, now=now, last=last)
            if self.state is State.READY:
                self._check_start(command)
            self.watchdog.command(now)
        self._command, self._target = command, command.position

    def apply(self, now: int, q: np.ndarray, dq: np.ndarray) -> AppliedCommand:
        """The command to apply in the period that starts at `now`, for the measured q (7,) rad and dq (7,) rad/s.

        Never raises for bad data: a state that is not finite, too fast or outside the joints' range is a
        fault, and the torque then fades to zero or brakes.
        """
        self._dq = np.array(dq, dtype=float)
        if not (isfinite(q @ q) and isfinite(dq @ dq)):
            self.watchdog.fault("measured state is not finite")
            self._dq = np.full(len(self.limits.joints), np.inf)
            return AppliedCommand(self.state, self._target, np.zeros_like(self._target), self.fade(), ("state",))
        self._check_state(q, dq)
        state = self.watchdog.poll(now)
        wanted, velocity = self._joint_target(state, q, dq)
        if state is State.IDLE:
            self._torque, changed = wanted, []
        else:
            self._torque, changed = limit_torque(self.limits, wanted, self._torque, q, dq)
        for name in changed:
            self.limited[name] += 1
        return AppliedCommand(state, self._target, velocity, self._torque, tuple(changed))

    def stop(self, cause: str = "stop requested") -> None:
        """Damp to rest from the next `apply` on, whatever comes, until `recover`."""
        self.watchdog.stop(cause)

    def fault(self, cause: str) -> None:
        """Damp to rest because the backend found something broken (a reflex, a lost connection)."""
        self.watchdog.fault(cause)

    def fade(self) -> np.ndarray:
        """Torque (7,) Nm in place of the next `apply`, a period's step nearer to none: the way out of control."""
        self._torque = self._torque - np.clip(self._torque, -self._step, self._step)
        return self._torque

    def recover(self, q: np.ndarray, applied: np.ndarray | None = None) -> None:
        """Leave stopped or fault: hold the measured q (7,) rad.

        applied (7,) Nm: what is on the arm now, from which torque may only go on at its rate; None: what `apply`
        gave last. It is something else where that did not reach the arm (a lost connection).
        Raises Refusal, counted: state, not_at_rest, not_finite.
        """
        with self.refusals.counting():
            check_finite(q=q)
            self.watchdog.recover(self.at_rest)
        if applied is not None:
            self._torque = applied
        self._hold(q)

    def _check_start(self, command: Command) -> None:
        error = np.abs(command.position - self._target)
        if (error > self.limits.start_tolerance).any():
            i = int(error.argmax())
            raise Refusal(
                Reason.START,
                f"first target of {self.limits.joints[i]}: expected the "
                f"measured position {self._target[i]:.3f} rad within "
                f"{self.limits.start_tolerance}, got {command.position[i]:.3f}",
            )

    def _hold(self, q: np.ndarray) -> None:
        self._target, self._command = np.clip(q, self.limits.position_lower, self.limits.position_upper), None

    def _joint_target(self, state: State, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Commanded torque and velocity of the joint target, before the guards."""
        if state is State.MOVING:
            return self._command.effort, self._command.velocity
        none = np.zeros(len(self.limits.joints))
        if state in (State.READY, State.HOLDING):
            return impedance_torque(q, dq, self._target, HOLD_STIFFNESS, HOLD_DAMPING_RATIO, none), none
        if state is State.IDLE:
            return none, none
        self._target = q.copy()  # damped: wherever the arm is, is where it should be
        return -REST_DAMPING * dq, none

    def _check_state(self, q: np.ndarray, dq: np.ndarray) -> None:
        limits = self.limits
        too_fast = np.abs(dq) > limits.velocity
        outside = (q < limits.position_lower) | (q > limits.position_upper)
        if not (np.count_nonzero(too_fast) or np.count_nonzero(outside)):
            return
        for i in np.flatnonzero(too_fast):
            self.watchdog.fault(f"{limits.joints[i]}: {dq[i]:.2f} rad/s is over the limit of {limits.velocity[i]:.2f}")
        for i in np.flatnonzero(outside):
            self.watchdog.fault(
                f"{limits.joints[i]}: {q[i]:.3f} rad is outside "
                f"{limits.position_lower[i]} to {limits.position_upper[i]}"
            )

    @property
    def _step(self) -> float:
        """Nm, by which torque may change in a period."""
        return self.limits.torque_step
