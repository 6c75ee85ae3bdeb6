"""The joint impedance controller: from measured states and targets to joint targets and torques.

A function of its inputs, in order: no clock, no ROS. The arm holds the pose it was found in until the first
trajectory or target comes; then it follows a trajectory, or targets of T_E with gains of their own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator
from dataclasses import dataclass, field

import numpy as np

from np_control.dynamics import Dynamics
from np_control.impedance import STIFFNESS_MAX, velocity_feedforward_offset
from np_control.impedance import torque as impedance_torque
from np_control.kinematics import IK_ITERATIONS, pose_distance, solve_ik
from np_control.safety import (
    LIMITS,
    Reason,
    Refusal,
    SafetyLimits,
    check_finite,
    limit_gains,
    limit_target,
    limit_torque,
    press_force_scale,
    slew_gains,
)
from np_control.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class ControllerConfig:
    """Gains and times of the controller."""

    stiffness: np.ndarray = field(default_factory=STIFFNESS_MAX.copy)
    """Joint stiffness (7,) Nm/rad while holding and on trajectories."""
    damping_ratio: float = 1.0
    """Damping ratio while holding and on trajectories."""
    policy_latency_ns: int = 20_000_000
    """A target computed from the state of time t takes effect at t plus this, ns."""
    reach_position: float = 0.05
    """Largest distance by which inverse kinematics may miss a target, m; beyond it the target is refused."""
    reach_angle: float = 0.2
    """The same for the angle, rad."""
    largest_gap_ns: int = 200_000_000
    """A longer time between two states, or a step no arm can make, restarts the controller, ns."""
    largest_target_age_ns: int = 500_000_000
    """An older target is refused; states are kept that long, to resolve a target at the state it was computed from."""
    stop_ns: int = 120_000_000
    """Time in which a trajectory that is broken off comes to rest, ns."""


@dataclass(frozen=True, eq=False)
class ControllerOutput:
    """The command for one state."""

    stamp: int
    """Of the state, ns."""
    position: np.ndarray
    """Joint target (7,) rad, no further ahead of the arm than it may press by."""
    velocity: np.ndarray
    """Velocity of the joint target (7,) rad/s."""
    torque: np.ndarray
    """Torque (7,) Nm, without gravity."""
    limited: tuple[str, ...]
    """Names of the guards that changed the torque."""


@dataclass(frozen=True, eq=False)
class _State:
    """A measured state of the arm."""

    stamp: int
    """ns."""
    q: np.ndarray
    """Joints (7,) rad."""
    dq: np.ndarray
    """Velocities (7,) rad/s."""


@dataclass(frozen=True, eq=False)
class _Target:
    """A target of T_E with its inverse kinematics."""

    stamp: int
    """Time from which it is in force, ns."""
    position: np.ndarray
    """Position of T_E (3,) m."""
    rotation: np.ndarray
    """Rotation of T_E (3, 3)."""
    joints: np.ndarray
    """Joint target (7,) rad."""
    gains: np.ndarray
    """Stiffness and damping ratio (2, 7)."""


_REST = np.zeros(7)  # rad/s, rad/s^2
_REST.setflags(write=False)
LARGEST_ANGLE, LARGEST_SPEED = 100.0, 1000.0
"""rad, rad/s: beyond them no joint has ever been. What is merely over the arm's limits is the backend's to fault."""


def _check_possible(q: np.ndarray, dq: np.ndarray) -> None:
    """Raises Refusal where the law's numbers would overflow: its torque would be none."""
    if q @ q <= LARGEST_ANGLE**2 and dq @ dq <= LARGEST_SPEED**2:  # finite too, in a fifth of the time
        return
    check_finite(q=q, dq=dq)
    for reason, name, values, largest in (
        (Reason.POSITION, "q", q, LARGEST_ANGLE),
        (Reason.VELOCITY, "dq", dq, LARGEST_SPEED),
    ):
        if np.abs(values).max() > largest:
            raise Refusal(reason, f"joint state: expected {name} within {largest:g}, got {np.asarray(values)}")


class Controller:
    """One arm's controller: `observe` every state, give trajectories and targets, take the command (`answer`)."""

    def __init__(
        self,
        config: ControllerConfig = ControllerConfig(),
        limits: SafetyLimits = LIMITS,
        dynamics: Dynamics | None = None,
    ):
        self.config, self.limits = config, limits
        self._dynamics = dynamics or Dynamics()
        self._own_gains = np.stack(limit_gains(config.stiffness, np.full(7, config.damping_ratio)))
        self._states: deque[_State] = deque(maxlen=config.largest_target_age_ns // limits.period_ns + 1)
        self._answer: ControllerOutput | None = None
        self._reach: tuple[int, np.ndarray | None] = (0, None)  # ns, and the rad (7,) that no joint goes in them
        self._begin_at(np.zeros(7))

    @property
    def stamp(self) -> int | None:
        """Stamp ns of the newest state."""
        return self._states[-1].stamp if self._states else None

    @property
    def follows_trajectory(self) -> bool:
        """Whether a trajectory is under way that was not broken off."""
        return self._trajectory is not None and self._broken_off is None

    def observe(self, stamp: int, q: np.ndarray, dq: np.ndarray) -> bool:
        """Take the state of `stamp` ns: q (7,) rad, dq (7,) rad/s. Returns whether it is a new beginning.

        A state that the arm cannot have reached since the one before (a reset, a restarted backend, a long
        gap) is one: trajectory and targets are dropped, and the arm is held where it is. The same state again
        changes nothing. Raises Refusal: not_finite; position, velocity for a state that no arm can have.
        """
        state = _State(stamp, np.array(q, dtype=float), np.array(dq, dtype=float))
        _check_possible(state.q, state.dq)
        if self._is_repetition(state):
            return False
        begins = self._is_beginning(state)
        if begins:
            self._begin_at(state.q)
        self._states.append(state)
        self._answer = None
        return begins

    def answer(self) -> ControllerOutput:
        """Joint target and torque for the newest state; further calls for it return the same."""
        if not self._states:
            raise Refusal(Reason.STATE, "no joint state has come yet")
        if self._answer is None:
            state = self._states[-1]
            wanted, position, velocity = self._joint_target(state)
            self._torque, limited = limit_torque(self.limits, wanted, self._torque, state.q, state.dq)
            self._answer = ControllerOutput(state.stamp, position, velocity, self._torque, tuple(limited))
        return self._answer

    def follow(self, trajectory: Trajectory, start: int | None = None, gains: np.ndarray | None = None) -> None:
        """Follow a trajectory from the state of `start` ns on, or from the next state that gets a command.

        gains (2, 7): rows stiffness Nm/rad, damping ratio; the controller's own where None. Targets given
        before are dropped. Raises Refusal: start where the trajectory does not begin at the measured pose,
        gains.
        """
        gains = self._own_gains if gains is None else np.stack(limit_gains(*gains))
        if not self._states:
            raise Refusal(Reason.STATE, "no joint state has come yet")
        error = np.abs(trajectory.positions[0] - self._states[-1].q)
        if (error > self.limits.start_tolerance).any():
            i = int(error.argmax())
            raise Refusal(
                Reason.START,
                f"trajectory begins with {self.limits.joints[i]} at "
                f"{trajectory.positions[0][i]:.3f} rad, {error[i]:.3f} rad from the measured "
                f"position; allowed are {self.limits.start_tolerance}",
            )
        self._trajectory, self._start, self._target, self._broken_off = trajectory, start, None, None
        self._targets.clear()
        self._gains_target = gains

    def set_target(
        self, stamp: int, position: np.ndarray, rotation: np.ndarray, stiffness: np.ndarray, ratio: np.ndarray
    ) -> bool:
        """Take a target at once: see `resolve_target`."""
        resolving = self.resolve_target(stamp, position, rotation, stiffness, ratio)
        while True:
            try:
                next(resolving)
            except StopIteration as end:
                return end.value

    def resolve_target(
        self, stamp: int, position: np.ndarray, rotation: np.ndarray, stiffness: np.ndarray, ratio: np.ndarray
    ) -> Generator[None, None, bool]:
        """Move T_E to position (3,) m, rotation (3, 3) in the base frame, with gains (7,) Nm/rad and (7,).

        stamp: ns of the state that the target was computed from; inverse kinematics starts from the joints measured
        then, as in training. Takes effect with the first state at or after stamp + policy_latency; a running
        trajectory ends. Gives back control after every step of inverse kinematics, for who has no time for
        all of them, and takes effect when exhausted. Returns whether the target was cut to the workspace.
        Raises Refusal (not_finite, workspace, gains, order, late, future, unreachable) and leaves everything
        as it was."""
        if not self._states:
            raise Refusal(Reason.STATE, "no joint state has come yet")
        position, clamped = limit_target(self.limits, np.asarray(position, dtype=float))
        check_finite(rotation=rotation)
        gains = np.stack(limit_gains(np.asarray(stiffness, dtype=float), np.asarray(ratio, dtype=float)))
        if self._newest_target is not None and stamp < self._newest_target:
            raise Refusal(
                Reason.ORDER, f"target of {stamp} ns is older than the one before it, of {self._newest_target} ns"
            )
        age = self._states[-1].stamp - stamp
        if age > self.config.largest_target_age_ns:
            raise Refusal(Reason.LATE, f"target of {stamp} ns is for a state {age / 1e6:.0f} ms ago")
        if age < -self.config.largest_gap_ns:
            raise Refusal(Reason.FUTURE, f"target of {stamp} ns is {-age / 1e6:.0f} ms ahead of the newest state")
        measured = next((state for state in reversed(self._states) if state.stamp <= stamp), self._states[0])
        joints = measured.q
        for _ in range(IK_ITERATIONS):
            joints = solve_ik(joints, position, rotation, iterations=1)
            yield
        distance, angle = pose_distance(joints, position, rotation)
        if distance > self.config.reach_position or angle > self.config.reach_angle:
            raise Refusal(
                Reason.UNREACHABLE,
                f"target {np.round(position, 3)} m: inverse kinematics misses "
                f"it by {distance:.3f} m and {angle:.2f} rad",
            )
        self._newest_target = stamp
        effective = stamp + self.config.policy_latency_ns
        self._targets.append(_Target(effective, position, rotation, joints, gains))
        return clamped

    def stop(self) -> None:
        """Break a trajectory off: come to rest on its path, within `stop_ns`. What else is held stays held."""
        if self._trajectory is None or self._broken_off is not None:
            return
        if not self._states or self._start is None or self._states[-1].stamp < self._start:
            self._trajectory = None  # it has not begun, or the arm is let go of
        else:
            self._broken_off = self._states[-1].stamp

    def hold(self) -> None:
        """Drop targets, break a trajectory off, and hold the present joint target with the controller's own
        gains."""
        self.stop()
        self._target = None
        self._targets.clear()
        self._gains_target = self._own_gains

    def release(self) -> None:
        """Hold whatever pose the next state has: for an arm that something else is stopping."""
        self._states.clear()

    def _is_repetition(self, state: _State) -> bool:
        last = self._states[-1] if self._states else None
        return last is not None and state.stamp == last.stamp and np.array_equal(state.q, last.q)

    def _is_beginning(self, state: _State) -> bool:
        if not self._states:
            return True
        last = self._states[-1]
        gap = state.stamp - last.stamp
        if not 0 < gap <= self.config.largest_gap_ns:
            return True
        if gap != self._reach[0]:  # in a graph it is always the same
            # Twice the speed limit is beyond what an arm does before its own brakes end it.
            self._reach = gap, 2 * self.limits.velocity * gap * 1e-9 + 1e-3
        return np.count_nonzero(np.abs(state.q - last.q) > self._reach[1]) > 0

    def _begin_at(self, q: np.ndarray) -> None:
        self._states.clear()
        self._position = np.clip(q, self.limits.position_lower, self.limits.position_upper)
        self._gains = self._gains_target = self._own_gains
        self._torque = np.zeros(7)
        self._trajectory: Trajectory | None = None
        self._start: int | None = None
        self._broken_off: int | None = None  # stamp from which the trajectory is slowed down
        self._targets: deque[_Target] = deque()  # to come, in order
        self._target: _Target | None = None  # in force
        self._newest_target: int | None = None

    def _advance(self, stamp: int) -> tuple[np.ndarray, np.ndarray]:
        """Move the joint target along the trajectory to where it is at `stamp` ns; its velocity and acceleration.

        One that was broken off goes on at a speed that falls to nothing, evenly: it stays on the path, which
        was found free.
        """
        self._start = stamp if self._start is None else self._start
        elapsed, pace, slowing = (stamp - self._start) * 1e-9, 1.0, 0.0
        if self._broken_off is not None:
            duration = self.config.stop_ns * 1e-9
            since = min((stamp - self._broken_off) * 1e-9, duration)
            elapsed = (self._broken_off - self._start) * 1e-9 + since - since**2 / (2 * duration)
            pace, slowing = 1 - since / duration, -1 / duration
        self._position, velocity, acceleration = self._trajectory.sample_with_acceleration(elapsed)
        if elapsed >= self._trajectory.duration or pace == 0.0:
            self._trajectory = None
            return _REST, _REST
        return pace * velocity, pace**2 * acceleration + slowing * velocity

    def _joint_target(self, state: _State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Torque of the law, position and velocity of the joint target; brings target and gains up to date."""
        velocity = acceleration = _REST
        if self._trajectory is not None:
            velocity, acceleration = self._advance(state.stamp)
        while self._targets and self._targets[0].stamp <= state.stamp:
            self._target, self._trajectory = self._targets.popleft(), None
            self._position, self._gains_target = self._target.joints, self._target.gains
            velocity = acceleration = _REST
        if self._gains is not self._gains_target:
            self._gains = slew_gains(self.limits, self._gains, self._gains_target, self.limits.period)
            if np.array_equal(self._gains, self._gains_target):
                self._gains = self._gains_target
        stiffness, ratio = self._gains
        feedforward = self._dynamics.feedforward(state.q, state.dq, acceleration)
        position = self._position
        target = position if velocity is _REST else velocity_feedforward_offset(position, velocity, stiffness, ratio)
        law = impedance_torque(state.q, state.dq, target, stiffness, ratio, 0.0)
        if self._target is None:  # the law of a policy's targets is the one it was trained with
            share = press_force_scale(self.limits, state.q, law)
            if share < 1.0:  # position and velocity by one share: so the law's torque is that share of what it was
                position, velocity = state.q + share * (position - state.q), state.dq + share * (velocity - state.dq)
                law = share * law
        return law + feedforward, position, velocity
