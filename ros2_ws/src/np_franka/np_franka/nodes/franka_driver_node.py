"""`franka_driver`: a Franka arm and hand behind the topics and services of docs/graph.md.

The robot paces everything, at 1 kHz: its state is read, the newest command goes out, and what is left of the
cycle is ROS's. Every second state is published.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from np_control.safety import LIMITS, Refusal, State
from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_franka.arm import Arm
from np_franka.driver import Cycle, Driver
from np_franka.gripper import Gripper
from np_franka.limits import FR3_LIMITS, Collision
from np_ros import qos
from np_ros.messages import BadMessage, joint_state_message, stamp_nanoseconds
from np_ros.node import Diagnostics, parameter, run
from np_ros.spin import Spinner, request_realtime

PERIOD = LIMITS.period_ns
APPLIED_EVERY = 5 * PERIOD  # ns between messages on applied_command: 100 Hz
STATISTICS_EVERY = 1.0  # s
IDLE_WAIT = 0.05  # s that is waited for messages while there is no robot to pace the loop
LEVELS = {State.HOLDING: DiagnosticStatus.WARN, State.STOPPED: DiagnosticStatus.ERROR,
          State.FAULT: DiagnosticStatus.ERROR}


class FrankaDriver(Node):
    """Translates between messages and a `Driver`."""

    def __init__(self):
        super().__init__("franka_driver")
        hostname = parameter(self, "hostname", "", "Address of the robot.")
        realtime = parameter(self, "realtime", "enforce", "enforce: refuse to start without a real-time "
                             "kernel and priority; ignore: only for a simulated robot.",
                             choices=("enforce", "ignore"))
        default = Collision()
        collision = Collision(
            parameter(self, "collision_torque", default.torque, "External torque of a joint, as a share of "
                      "its torque limit, at which the robot stops itself.", 0.05, 1.0),
            parameter(self, "collision_force", default.force, "The same for the force at the hand, N.",
                      5.0, 100.0),
            parameter(self, "collision_moment", default.moment, "The same for its moment, Nm.", 1.0, 50.0))
        has_gripper = parameter(self, "gripper", True, "Whether the robot has a Franka Hand.")
        priority = parameter(self, "realtime_priority", 0, "SCHED_FIFO priority; 0 asks for none.", 0, 90)
        if not hostname:
            raise ValueError("parameter hostname: expected the robot's address, got none")
        self._gripper = Gripper(hostname) if has_gripper else None
        arm = Arm(hostname, FR3_LIMITS, collision, enforce_realtime=realtime == "enforce")
        self._driver = Driver(arm, FR3_LIMITS)
        self._published = -1  # number of the period published last
        self._reported: tuple[State, str] | None = None
        self.diagnostics = Diagnostics(self)
        self.diagnostics.values.update(mode="realtime", hostname=hostname)
        stream = qos.publisher(lockstep=False)
        self._joint_states = self.create_publisher(JointState, "joint_states", stream)
        self._motor_states = self.create_publisher(JointState, "motor_states", stream)
        self._applied = self.create_publisher(JointState, "applied_command", stream)
        self.create_subscription(JointState, "effort_command", self._on_command,
                                 qos.subscriber(lockstep=False))
        self.create_subscription(Float64, "gripper_command", self._on_gripper, qos.EVENT)
        self.create_service(Trigger, "~/stop", self._service(self._stop))
        self.create_service(Trigger, "~/recover", self._service(self._recover))
        self.create_timer(STATISTICS_EVERY, self._on_statistics)
        if priority and not request_realtime(priority):
            self.get_logger().warn(f"SCHED_FIFO priority {priority} is not permitted; running without it")
        gc.collect()
        gc.freeze()  # what start-up made stays: later collections need not walk it
        try:
            self._driver.start(time.time_ns())
        except OSError:
            self._close_gripper()
            raise
        self._report()

    def cycle(self) -> float:
        """One cycle of the robot; how long s may be waited for messages after it."""
        cycle = self._driver.cycle()
        self._report()
        if cycle is None:
            return IDLE_WAIT
        period = cycle.stamp // PERIOD
        if period > self._published:
            self._publish(cycle, period * PERIOD)
            self._published = period
        return 0.0

    def _publish(self, cycle: Cycle, stamp: int) -> None:
        reading, applied = cycle.reading, cycle.applied
        fingers = np.full(2, 0.0 if self._gripper is None else self._gripper.opening)
        unknown = np.zeros(2)  # the hand tells neither speed nor force
        self._joint_states.publish(joint_state_message(
            stamp, STATE_NAMES, np.append(reading.q, fingers), np.append(reading.dq, unknown),
            np.append(reading.torque, unknown)))
        self._motor_states.publish(joint_state_message(
            stamp, JOINT_NAMES, reading.theta, reading.dtheta, reading.commanded))
        if stamp % APPLIED_EVERY == 0:
            self._applied.publish(joint_state_message(
                stamp, JOINT_NAMES, applied.position, applied.velocity, applied.torque))
            if self._gripper is not None:
                self._gripper.poll()
                self.diagnostics.values["gripper_error"] = self._gripper.error
        self.diagnostics.values.update(
            stamp=stamp, robot_mode=reading.mode, robot_errors=reading.errors,
            command_success_rate=round(reading.success_rate, 3))

    # Commands

    def _on_command(self, message: JointState) -> None:
        try:
            self._driver.offer(stamp_nanoseconds(message.header.stamp), message.name, message.position,
                               message.velocity, message.effort)
        except BadMessage as error:
            self._refuse(error.kind, str(error))
        except Refusal as refusal:
            self._refuse(refusal.reason, str(refusal))

    def _on_gripper(self, message: Float64) -> None:
        try:
            if self._gripper is None:
                raise ValueError("this robot has no gripper")
            self._gripper.move(message.data)
        except ValueError as error:
            self._refuse("gripper", str(error))

    def _refuse(self, reason: str, text: str) -> None:
        self.diagnostics.count(f"refused_{reason}")
        self.get_logger().warn(f"refused: {text}", throttle_duration_sec=1.0)

    @staticmethod
    def _service(action: Callable[[], str]) -> Callable:
        def handle(_request, response):
            try:
                response.message, response.success = action(), True
            except (ValueError, OSError) as error:  # Refusal, ArmError
                response.message, response.success = str(error), False
            return response
        return handle

    def _stop(self) -> str:
        self._driver.stop()
        self._report()
        return "stop requested"

    def _recover(self) -> str:
        try:
            self._driver.recover(time.time_ns())
        finally:
            self._report()
        return "holding the measured posture"

    # Diagnostics

    def _report(self) -> None:
        """Tell the state, and what it means: published at once when it changes."""
        state, cause = self._driver.state, self._driver.filter.watchdog.cause
        if (state, cause) != self._reported:
            self._reported = state, cause
            self.diagnostics.values.update(state=str(state), last_error=self._driver.error)
            self.diagnostics.report(LEVELS.get(state, DiagnosticStatus.OK), f"{state}: {cause}")

    def _on_statistics(self) -> None:
        values = self.diagnostics.values
        values["lost_cycles"] = self._driver.lost_cycles
        values["clock_lag_ms"] = round((time.time_ns() - self._driver.stamp) * 1e-6, 1)
        names = ("cycle_p50_ms", "cycle_p99_ms", "cycle_max_ms")
        for name, milliseconds in zip(names, self._driver.period_percentiles(50, 99, 100)):
            values[name] = round(milliseconds, 3)
        limited = self._driver.filter.limited
        values.update({f"limited_{name}": count for name, count in limited.items() if count})

    def _close_gripper(self) -> None:
        if self._gripper is not None:
            self._gripper.close()

    def destroy_node(self) -> None:
        """Bring the arm to rest and leave the robot."""
        self._driver.close()
        self._close_gripper()
        super().destroy_node()


def spin(node: FrankaDriver, spinner: Spinner) -> None:
    """The robot's cycle, and what has come meanwhile, in turn."""
    while True:
        spinner.spin_once(node.cycle())


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable `franka_driver`."""
    return run(FrankaDriver, args, spin=spin)


if __name__ == "__main__":
    raise SystemExit(main())
