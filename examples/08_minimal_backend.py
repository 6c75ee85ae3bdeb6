"""A backend in real time that keeps the contract of docs/reference/graph.md: seven uncoupled joints.
`YourArm` is where a robot of your own belongs; everything else stays. Run: python examples/08_minimal_backend.py"""

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from np_control.safety import LIMITS, Refusal, SafetyFilter, State
from np_description.message_arrays import BadMessage, stamp_nanoseconds
from np_description.panda import FINGER_MAX, FINGER_SPEED, JOINT_NAMES, NOMINAL, STATE_NAMES
from np_ros import qos
from np_ros.messages import joint_state_message
from np_ros.node import Diagnostics, run

PERIOD = LIMITS.period_ns
BAD = {State.HOLDING: DiagnosticStatus.WARN} | dict.fromkeys((State.STOPPED, State.FAULT), DiagnosticStatus.ERROR)


class YourArm:
    """Joints q (7,) rad, dq (7,) rad/s; two fingers, m. Torques are without gravity, as a robot that compensates its own."""

    def __init__(self):
        self.q, self.dq, self.torque = NOMINAL.ready.copy(), np.zeros(7), np.zeros(7)
        self.fingers, self.opening = 0.0, 0.0

    def step(self, torque: np.ndarray) -> None:
        """One period with this torque (7,) Nm."""
        self.torque = torque
        self.dq = self.dq + torque / LIMITS.inertia * LIMITS.period
        self.q = self.q + self.dq * LIMITS.period
        self.fingers += np.clip(
            self.opening - self.fingers, -FINGER_SPEED * LIMITS.period, FINGER_SPEED * LIMITS.period
        )


class MinimalBackend(Node):
    """Translates between messages, the arm, and the filter that decides what may reach it."""

    def __init__(self):
        super().__init__("minimal_backend")
        self._arm, self._filter, self._stamp = YourArm(), SafetyFilter(), 0
        self._filter.start(self._arm.q)
        self.diagnostics = Diagnostics(self)
        out, into = qos.publisher(lockstep=False), qos.subscriber(lockstep=False)
        self._states = self.create_publisher(JointState, "joint_states", out)
        self._applied = self.create_publisher(JointState, "applied_command", out)
        self.create_subscription(JointState, "effort_command", self._on_command, into)
        self.create_subscription(Float64, "gripper_command", self._on_gripper, qos.EVENT)
        self.create_service(Trigger, "~/stop", lambda _, answer: self._answer(answer, self._filter.stop))
        self.create_service(Trigger, "~/recover", lambda _, a: self._answer(a, self._filter.recover, self._arm.q))
        self.create_timer(PERIOD / 1e9, self._on_period, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _on_command(self, m: JointState) -> None:
        try:
            stamp = stamp_nanoseconds(m.header.stamp)
            self._filter.offer(stamp, m.name, m.position, m.velocity, m.effort, now=self._stamp)
        except Refusal as refusal:
            self.diagnostics.refuse(refusal.reason, refusal)
        except BadMessage as error:
            self.diagnostics.refuse(error.kind, error)

    def _on_gripper(self, message: Float64) -> None:
        if 0 <= message.data <= FINGER_MAX:
            self._arm.opening = message.data
        else:
            self.diagnostics.refuse("gripper", f"opening: expected 0 .. {FINGER_MAX} m, got {message.data}")

    def _answer(self, answer: Trigger.Response, action, *arguments) -> Trigger.Response:
        try:
            action(*arguments)
            answer.success = True
        except Refusal as refusal:
            answer.message = str(refusal)
        self._report()
        return answer

    def _on_period(self) -> None:
        applied = self._filter.apply(self._stamp, self._arm.q, self._arm.dq)
        if self._stamp % (5 * PERIOD) == 0:
            values = applied.position, applied.velocity, applied.torque
            self._applied.publish(joint_state_message(self._stamp, JOINT_NAMES, *values))
        self._arm.step(applied.torque)
        self._stamp += PERIOD
        arm, fingers = self._arm, np.full(2, self._arm.fingers)
        values = np.append(arm.q, fingers), np.append(arm.dq, np.zeros(2)), np.append(arm.torque, np.zeros(2))
        self._states.publish(joint_state_message(self._stamp, STATE_NAMES, *values))
        self._report()

    def _report(self) -> None:
        state = self._filter.state
        self.diagnostics.values["state"] = str(state)
        self.diagnostics.report(BAD.get(state, DiagnosticStatus.OK), f"{state}: {self._filter.watchdog.cause}")


if __name__ == "__main__":
    raise SystemExit(run(MinimalBackend))
