"""One arm behind guards and state machine of `np_control.safety`, a cycle of the robot at a time. No ROS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import monotonic, time_ns

import numpy as np

from np_control.controller import ControllerOutput
from np_control.safety import AppliedCommand, Refusal, SafetyFilter, SafetyLimits, State
from np_franka.arm import FrankaArm
from np_franka.checklist import Checklist
from np_franka.client import ArmError, ArmReading
from np_franka.clock import RobotClock
from np_franka.limits import CYCLE_NS
from np_franka.onboard import Onboard
from np_franka.timing import CycleTimes

REST_TIMEOUT = 2.0  # s that the arm may take to come to rest at the end


@dataclass(frozen=True, eq=False)
class Cycle:
    """One cycle: `stamp` ns on the driver's clock, the robot's state, what was applied then.

    On board, answer: the controller's command, unless it is silent; refusal: where that, or a target, was refused;
    clamped: whether a target was cut to the workspace."""

    stamp: int
    reading: ArmReading
    applied: AppliedCommand
    answer: ControllerOutput | None = None
    refusal: Refusal | None = None
    clamped: bool = False


class Driver:
    """Reads a state, guards and sends the newest command, over and over: call `cycle` without pause.

    Between commands the last one holds: torques change at the controller's rate, guards act at the robot's.
    With a controller on board they change at the robot's too; no other node commands it then. An error in
    between is a fault with the robot's message as cause; `recover` clears it, and connects again where the
    connection was lost. host_time: ns, the clock that stamps are led by."""

    def __init__(
        self,
        arm: FrankaArm,
        limits: SafetyLimits,
        checklist: Checklist,
        onboard: Onboard | None = None,
        host_time: Callable[[], int] = time_ns,
    ):
        self.arm, self.checklist, self.onboard = arm, checklist, onboard
        self.filter = SafetyFilter(limits)
        self.clock, self._host_time = RobotClock(), host_time
        self.lost_cycles = self.commands = 0  # commands: accepted
        self.error = ""  # what broke last, even where a stop came first
        self._read_at: float | None = None
        self.times = CycleTimes()  # since the arm was taken under control or recovered last
        self.replies = CycleTimes()  # from a state until its command is written; the node clears them
        self.overrun = 0.0  # s of work beyond the robot's cycle, in all

    @property
    def state(self) -> State:
        """State of the watchdog."""
        return self.filter.state

    @property
    def stamp(self) -> int:
        """Of the newest state, ns on the driver's clock."""
        return self.clock.stamp

    def start(self) -> None:
        """Connect, and hold the arm where it is.

        A robot that must not move now is connected all the same, at fault. Raises ArmError if none replies.
        """
        reading = self._connect()
        try:
            obstacle = self._obstacle()
            if not obstacle:
                self.filter.start(reading.q)
                self._take_control()
        except ArmError as error:
            obstacle = str(error)
        if obstacle:
            self._fault(obstacle)

    def cycle(self) -> Cycle | None:
        """One cycle, paced by the robot; None without a connection."""
        if not self.arm.is_connected:
            return None
        try:
            reading = self._read()
        except ArmError as error:
            self._fault(str(error))
            return None
        answer, refusal = self._command(reading)
        applied = self.filter.apply(self.stamp, reading.q, reading.dq)
        if not self.arm.is_controlled:
            return Cycle(self.stamp, reading, replace(applied, torque=np.zeros(7)))
        try:
            self.arm.write(applied.torque)
            self.replies.add(monotonic() - self._read_at)
        except ArmError as error:
            self._fault(str(error))
        clamped, thought = self._think()
        refusal = refusal or thought
        return Cycle(self.stamp, reading, applied, answer, refusal, clamped)

    def offer(
        self,
        stamp: int,
        names: Sequence[str],
        position: Sequence[float],
        velocity: Sequence[float],
        effort: Sequence[float],
    ) -> None:
        """Take a command from the next cycle on. Raises Refusal, as SafetyFilter.offer."""
        self.filter.offer(stamp, names, position, velocity, effort, now=self.stamp)
        self.commands += 1

    def stop(self, cause: str = "stop requested") -> None:
        """Damp to rest from the next cycle on, until `recover`."""
        self.filter.stop(cause)

    def recover(self) -> None:
        """Hold the measured pose again, after connecting and clearing the robot's errors where needed.

        Raises Refusal, or ArmError with the robot's message; the arm then stays stopped or at fault.
        """
        may_move = self.filter.watchdog.may_move
        if self.onboard is not None and not may_move:
            self.onboard.release()
        if may_move or self.arm.is_controlled:
            # What is refused anyway is not checked first: a file takes longer to read than a cycle.
            if self.filter.at_rest and not may_move:
                self._check()
            self.filter.recover(self._reading.q)
            self.times.clear()
            return
        if not self.arm.is_connected:
            self._connect()
        self.arm.clear_errors()
        self._check()
        reading = self._read()
        self.filter.apply(self.stamp, reading.q, reading.dq)  # whether it is at rest
        self.filter.recover(reading.q, applied=np.zeros(7))
        try:
            self._take_control()
        except ArmError as error:
            self._fault(str(error))
            raise

    def close(self) -> None:
        """Bring the arm to rest, take the torque off it, end the motion and leave the robot."""
        self.filter.stop("the driver ends")
        deadline = monotonic() + REST_TIMEOUT
        while self.arm.is_controlled and not self.filter.is_slack and monotonic() < deadline:
            self.cycle()
        try:
            while self.arm.is_controlled:  # once, unless it has not come to rest in time
                self._read()
                torque = self.filter.fade()
                self.arm.write(torque, last=not torque.any())
        except ArmError:
            pass  # it ends in any case, and the robot holds itself
        self.arm.close()

    def _command(self, reading: ArmReading) -> tuple[ControllerOutput | None, Refusal | None]:
        """Let the controller on board command the arm, by the way every command takes."""
        if self.onboard is None:
            return None, None
        if not self.filter.watchdog.may_move:
            self.onboard.release()
            return None, None
        try:
            answer = self.onboard.answer(self.stamp, reading.q, reading.dq)
            if answer is not None:
                self.offer(answer.stamp, self.filter.limits.joints, answer.position, answer.velocity, answer.torque)
        except Refusal as refusal:
            return None, refusal
        return answer, None

    def _think(self) -> tuple[bool, Refusal | None]:
        """Give the controller on board what is left of the cycle."""
        if self.onboard is None or not self.filter.watchdog.may_move:
            return False, None
        try:
            return self.onboard.think(), None
        except Refusal as refusal:
            return False, refusal

    def _obstacle(self) -> str:
        # Facts cannot be read under control: the robot was in order when that began, and ends it where it no longer is.
        facts = None if self.arm.is_controlled else self.arm.facts()
        return "; ".join(self.checklist.problems(facts))

    def _check(self) -> None:
        """Raise ArmError where the arm must not be moved."""
        if obstacle := self._obstacle():
            raise ArmError(obstacle)

    def _fault(self, cause: str) -> None:
        self.error = cause
        self.filter.fault(cause)

    def _connect(self) -> ArmReading:
        self.arm.connect()
        reading = self._reading = self.arm.read()
        self.clock.begin(reading.time, self._host_time(), after=CYCLE_NS)
        return reading

    def _take_control(self) -> None:
        self._read_at = None
        self.times.clear()
        self.arm.start()

    def _read(self) -> ArmReading:
        if self._read_at is not None:
            self.overrun += max(0.0, monotonic() - self._read_at - CYCLE_NS * 1e-9)
        before, reading = self._reading, self.arm.read()
        now = monotonic()
        if self._read_at is not None:
            self.times.add(now - self._read_at)
            self.lost_cycles += max(0, (reading.time - before.time) // CYCLE_NS - 1)
        self._read_at, self._reading = now, reading
        self.clock.go_on(reading.time, self._host_time())
        return reading
