"""`joint_impedance`, the 500 Hz controller: publishes an `effort_command` for each of `joint_states`, of the same stamp.

Lockstep: the command for the state of a policy tick waits for the tick, and for the trajectory or target that
belongs to it. Real time: the command is published at once, with whatever has come.
"""

from __future__ import annotations

import gc
import time
from collections import deque

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import JointState

from np_control.controller import Controller, ControllerConfig, ControllerOutput
from np_control.impedance import DAMPING_RATIO_MAX, DAMPING_RATIO_MIN
from np_control.lockstep_input import LockstepCommandInput
from np_control.nodes import inputs
from np_control.nodes.inputs import Pose
from np_control.realtime_input import RealtimeCommandInput
from np_control.safety import LIMITS, Refusal
from np_control.trajectory import Trajectory
from np_description.control_rate import SECOND
from np_description.message_arrays import BadMessage, joint_state_arrays, stamp_nanoseconds
from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_description.phases import APPROACH, FAULT, PRE, PhaseState
from np_ros import qos
from np_ros.low_latency.spin import request_realtime
from np_ros.messages import JointStateWriter
from np_ros.node import Diagnostics, create_steady_timer, declare_mode, parameter, run

MEASURED_ANSWERS = 5000  # commands over which times are reported: 10 s


class JointImpedance(Node):
    """Translates messages for one `Controller`, and counts what it refuses."""

    def __init__(self):
        super().__init__("joint_impedance")
        mode = declare_mode(self)
        barrier = parameter(
            self, "tick_barrier", True, "Lockstep: wait for ticks, trajectories and targets, not for states only."
        )
        policy_rate = parameter(self, "policy_rate", 10, "Policy ticks a second; a divisor of 500.", 1, 500)
        latency = parameter(
            self, "policy_latency", 0.02, "s from the state that a target is for until it takes effect.", 0.0, 1.0
        )
        ratio = parameter(
            self,
            "damping_ratio",
            1.0,
            "Damping ratio while holding and on trajectories.",
            DAMPING_RATIO_MIN,
            DAMPING_RATIO_MAX,
        )
        priority = parameter(self, "realtime_priority", 0, "SCHED_FIFO priority; 0: none.", 0, 90)
        lockstep = mode == "lockstep"
        if SECOND % (policy_rate * LIMITS.period_ns):
            raise ValueError(
                f"parameter policy_rate: expected a divisor of {SECOND // LIMITS.period_ns}, got {policy_rate}"
            )
        self._waits, self._is_realtime = lockstep and barrier, not lockstep
        # In lockstep no state is ever skipped: any gap is a reset.
        gap = LIMITS.period_ns if lockstep else ControllerConfig.largest_gap_ns
        self._controller = Controller(
            ControllerConfig(
                damping_ratio=ratio,
                policy_latency_ns=round(latency * SECOND),
                largest_gap_ns=gap,
            )
        )
        self._gate: LockstepCommandInput[Trajectory, Pose, np.ndarray] = LockstepCommandInput(SECOND // policy_rate)
        self._following = RealtimeCommandInput(self._controller)
        self._is_fault = False
        self._answered: int | None = None
        self._sent = 0  # ns on the host's clock, when the newest state was published
        self._limited: dict[str, int] = {}
        self._seconds: deque[float] = deque(maxlen=MEASURED_ANSWERS)
        self.diagnostics = Diagnostics(self)
        self.diagnostics.values["mode"] = mode
        if priority and not request_realtime(priority):
            self.get_logger().warn(f"SCHED_FIFO priority {priority} is not permitted; running without it")
        self._writer = JointStateWriter(JOINT_NAMES)
        self._command = self.create_publisher(JointState, "effort_command", qos.publisher(lockstep))
        self.create_subscription(JointState, "joint_states", self._on_state, qos.subscriber(lockstep))
        inputs.subscribe(self, self, LIMITS, lockstep=lockstep)
        create_steady_timer(self, 1.0, self._report)
        gc.collect()
        gc.freeze()  # what start-up made stays: later collections need not walk it

    # States in, commands out

    def _on_state(self, message: JointState, info: dict) -> None:
        try:
            stamp = stamp_nanoseconds(message.header.stamp)
            q, dq, _ = joint_state_arrays(message, STATE_NAMES)
            self._check_owner()
            if self._is_fault:
                self._controller.release()
            if self._controller.observe(stamp, q[:7], dq[:7]):
                self._gate.begin(stamp)
                self._answered = None
                # In lockstep time has waited for a controller that comes late: without a phase yet it goes on.
                if self._following.phase or not self._waits:
                    self._following.begin()
        except (BadMessage, Refusal) as error:
            self.refuse(error)
            return
        self._sent = info["source_timestamp"]
        if stamp == self._answered:
            self._publish(self._controller.answer())  # the state was published again: so is its command
        else:
            self._answer()

    def _check_owner(self) -> None:
        if self._is_realtime:
            try:
                self._following.check_owner()
            except Refusal as refusal:
                self.refuse(refusal)

    def _answer(self) -> None:
        """Publish the command for the newest state, unless it has one, or something it waits for is missing."""
        stamp = self._controller.stamp
        if stamp is None or stamp == self._answered:
            return
        if self._waits:
            missing = self._gate.missing(stamp)
            self.diagnostics.values["waiting_for"] = missing or ""
            if missing:
                self._sent = 0  # how long others take is not this node's time
                return
            self._take_tick(stamp)
        answer = self._controller.answer()
        self._publish(answer)
        self._answered = stamp
        for name in answer.limited:
            self._limited[name] = self._limited.get(name, 0) + 1
        if self._sent:
            self._seconds.append(time.time() - self._sent * 1e-9)

    def _publish(self, answer: ControllerOutput) -> None:
        self._command.publish(self._writer.fill(answer.stamp, answer.position, answer.velocity, answer.torque))

    # Trajectories and targets

    def _take_tick(self, stamp: int) -> None:
        tick = self._gate.take(stamp)
        if tick is None:
            return
        if tick.phase == APPROACH and tick.trajectory is not None:
            self._following.enter(PRE)  # which has no tick of its own
        self._following.enter(tick.phase)
        if tick.trajectory is not None:
            trajectory, gains = tick.trajectory
            self._following.gains(gains)
            self._follow(trajectory, stamp)
        if tick.target is not None:
            pose, gains = tick.target
            self._following.gains(gains)
            self._aim(stamp, pose)

    def _follow(self, trajectory: Trajectory | None, start: int | None) -> None:
        try:
            self._following.trajectory(trajectory, start)
        except Refusal as refusal:
            self.refuse(refusal)

    def _aim(self, stamp: int, pose: Pose | None) -> None:
        try:
            if self._following.pose(stamp, pose):
                self.diagnostics.count("targets_cut_to_workspace")
        except Refusal as refusal:
            self.refuse(refusal)

    def on_trajectory(self, stamp: int, trajectory: Trajectory | None) -> None:
        """A plan; the wait for it also ends with a refused one."""
        if self._waits:
            self._gate.trajectory(stamp, trajectory)
            self._answer()
        else:
            self._follow(trajectory, None)

    def on_gains(self, gains: np.ndarray | None) -> None:
        """Gains for the pose that comes next."""
        if self._waits:
            self._gate.gains(gains)
            self._answer()
        else:
            self._following.gains(gains)

    def on_pose(self, stamp: int, pose: Pose | None) -> None:
        """A target of T_E."""
        if self._waits:
            self._gate.pose(stamp, pose)
            self._answer()
        else:
            self._aim(stamp, pose)

    def on_tick(self, stamp: int, state: PhaseState) -> None:
        """A policy tick."""
        if self._waits:
            self._gate.tick(stamp, state)
            self._answer()
        else:
            self._following.heartbeat(state.phase)

    def on_heartbeat(self, phase: str) -> None:
        """The owner of the phase still runs."""
        self._following.heartbeat(phase)

    def on_phase(self, state: PhaseState) -> None:
        """A stopped arm is not where its target was: the target goes along with it until the fault is
        over. Where nobody waits the phase takes effect as it comes, at a barrier with its tick.
        """
        self._is_fault = state.phase == FAULT
        if not self._waits:
            try:
                self._following.enter(state.phase)
            except Refusal as refusal:
                self.refuse(refusal)

    # Diagnostics

    def refuse(self, error: BadMessage | Refusal) -> None:
        """Count and log what is not carried out."""
        self.diagnostics.values["last_refusal"] = str(error)
        self.diagnostics.refuse(error.reason if isinstance(error, Refusal) else error.kind, error)

    def _report(self) -> None:
        values = self.diagnostics.values
        if self._seconds:
            # From the state's publication to the end of the command's, both on this host's clock.
            milliseconds = 1e3 * np.array(self._seconds)
            for name, percentile in (("p50", 50), ("p99", 99), ("max", 100)):
                values[f"answer_{name}_ms"] = round(float(np.percentile(milliseconds, percentile)), 3)
        values.update({f"limited_{name}": count for name, count in self._limited.items()})
        is_waiting = self._controller.stamp is None
        self.diagnostics.report(DiagnosticStatus.OK, "waiting for joint_states" if is_waiting else "running")


def main(args=None) -> int:
    """Entry point of the executable `joint_impedance`."""
    return run(JointImpedance, args)


if __name__ == "__main__":
    raise SystemExit(main())
