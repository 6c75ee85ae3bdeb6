"""`franka_driver`: a Franka arm and hand behind the topics and services of docs/reference/graph.md.

The robot paces everything, at 1 kHz: its state is read, the newest command goes out, and what is left of the
cycle is ROS's. Every second state is published. Commands are effort_command, or, with `control:=onboard`,
what the controller on board makes of trajectories and targets."""

from __future__ import annotations

import gc
from collections.abc import Callable
from itertools import count

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from np_control.nodes import inputs
from np_control.safety import LIMITS, Refusal
from np_control.trajectory import Trajectory
from np_description.message_arrays import BadMessage, stamp_nanoseconds
from np_description.panda import BASE_FRAME, JOINT_NAMES, STATE_NAMES
from np_description.phases import PhaseState
from np_franka.driver import Cycle
from np_franka.gripper import Gripper
from np_franka.nodes.condition import condition
from np_franka.nodes.settings import declare
from np_franka.onboard import Onboard
from np_franka.state_throttle import StateChangeThrottle
from np_ros import qos
from np_ros.low_latency.spin import Spinner, request_realtime
from np_ros.messages import JointStateWriter, wrench_message
from np_ros.node import Diagnostics, create_steady_timer, run

PERIOD = LIMITS.period_ns
APPLIED_EVERY = 5 * PERIOD  # ns between messages on applied_command: 100 Hz
STATISTICS_EVERY = 1.0  # s
SERVED_EVERY = 4  # cycles from one look at timers and services to the next: a stop takes effect within 5 ms
IDLE_WAIT = 0.05  # s that is waited for messages while there is no robot to pace the loop


class FrankaDriver(Node):
    """Translates between messages and a `Driver`."""

    def __init__(self):
        super().__init__("franka_driver")
        settings, self._driver = declare(self)
        self._gripper = Gripper(settings.robot, settings.hostname) if settings.has_gripper else None
        # A simulated robot's clock is as slow as the computer that it has.
        self._judges_clock = settings.realtime == "enforce"
        self._published = -1  # number of the period published last
        self._telling = StateChangeThrottle()
        self.diagnostics = Diagnostics(self)
        self.diagnostics.values.update(
            mode="realtime",
            robot=settings.robot,
            hostname=settings.hostname,
            control=settings.control,
            calibration=settings.calibration,
        )
        stream = qos.publisher(lockstep=False)
        self._joint_states = self.create_publisher(JointState, "joint_states", stream)
        self._motor_states = self.create_publisher(JointState, "motor_states", stream)
        self._applied = self.create_publisher(JointState, "applied_command", stream)
        self._wrench = self.create_publisher(WrenchStamped, "external_wrench", stream)
        self._whole, self._arm = JointStateWriter(STATE_NAMES), JointStateWriter(JOINT_NAMES)
        self._effort = None
        if self._driver.onboard is None:
            self.create_subscription(JointState, "effort_command", self._on_command, qos.subscriber(lockstep=False))
        else:  # commands of the controller on board are published where another's would be, for recordings
            self._effort = self.create_publisher(JointState, "effort_command", stream)
            inputs.subscribe(self, self, self._driver.filter.limits, lockstep=False)
        self.create_subscription(Float64, "gripper_command", self._on_gripper, qos.EVENT)
        self.create_service(Trigger, "~/stop", self._service(self._stop))
        self.create_service(Trigger, "~/recover", self._service(self._recover))
        create_steady_timer(self, STATISTICS_EVERY, self._on_statistics)
        priority = settings.priority
        if priority and not request_realtime(priority):
            self.get_logger().warn(f"SCHED_FIFO priority {priority} is not permitted; running without it")
        gc.collect()
        gc.freeze()  # what start-up made stays: later collections need not walk it
        try:
            self._driver.start()
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
        if cycle.refusal is not None:
            self.refuse(cycle.refusal)
        if cycle.clamped:
            self.diagnostics.count("targets_cut_to_workspace")
        period = cycle.stamp // PERIOD
        if period > self._published:
            self._publish(cycle, period * PERIOD)
            self._published = period
        return 0.0

    def _publish(self, cycle: Cycle, stamp: int) -> None:
        reading, applied = cycle.reading, cycle.applied
        fingers = np.full(2, 0.0 if self._gripper is None else self._gripper.opening)
        unknown = np.zeros(2)  # the hand measures neither speed nor force
        self._joint_states.publish(
            self._whole.fill(
                stamp, np.append(reading.q, fingers), np.append(reading.dq, unknown), np.append(reading.torque, unknown)
            )
        )
        if reading.theta is not None:
            self._motor_states.publish(self._arm.fill(stamp, reading.theta, reading.dtheta, reading.commanded))
        self._wrench.publish(wrench_message(stamp, BASE_FRAME, reading.wrench))
        if self._effort is not None and cycle.answer is not None:
            answer = cycle.answer
            self._effort.publish(self._arm.fill(stamp, answer.position, answer.velocity, answer.torque))
        if stamp % APPLIED_EVERY == 0:
            self._applied.publish(self._arm.fill(stamp, applied.position, applied.velocity, applied.torque))
            if self._gripper is not None:
                self._gripper.poll()
                self.diagnostics.values["gripper_error"] = self._gripper.error
        self.diagnostics.values.update(
            stamp=stamp,
            robot_mode=reading.mode,
            robot_errors=reading.errors,
            command_success_rate=round(reading.success_rate, 3),
        )

    # Commands

    def _on_command(self, message: JointState) -> None:
        try:
            self._driver.offer(
                stamp_nanoseconds(message.header.stamp),
                message.name,
                message.position,
                message.velocity,
                message.effort,
            )
        except (BadMessage, Refusal) as error:
            self.refuse(error)

    def on_trajectory(self, _stamp: int, trajectory: Trajectory | None) -> None:
        """On board: a plan."""
        self._lead(lambda onboard: onboard.trajectory(trajectory))

    def on_gains(self, gains: np.ndarray | None) -> None:
        """On board: gains for the pose that comes next."""
        self._driver.onboard.gains(gains)

    def on_pose(self, stamp: int, pose: inputs.Pose | None) -> None:
        """On board: a target of T_E."""
        self._lead(lambda onboard: onboard.pose(stamp, pose))

    def on_tick(self, _stamp: int, _state: PhaseState) -> None:
        """On board: a policy tick has no information that its phase has not."""

    def on_phase(self, state: PhaseState) -> None:
        """On board: the phase of the episode."""
        try:
            self._driver.onboard.phase(state.phase)
        except Refusal as refusal:
            self.refuse(refusal)

    def on_heartbeat(self, phase: str) -> None:
        """On board: the owner of the phase still runs."""
        self._driver.onboard.heartbeat(phase)

    def _lead(self, action: Callable[[Onboard], None]) -> None:
        try:
            self._driver.filter.watchdog.check_may_move()
            action(self._driver.onboard)
        except Refusal as refusal:
            self.refuse(refusal)

    def _on_gripper(self, message: Float64) -> None:
        try:
            if self._gripper is None:
                raise ValueError("this robot has no gripper")
            self._gripper.move(message.data)
        except ValueError as error:
            self.diagnostics.refuse("gripper", error)

    def refuse(self, error: BadMessage | Refusal) -> None:
        """Count and log what is not carried out."""
        self.diagnostics.refuse(error.reason if isinstance(error, Refusal) else error.kind, error)

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
        if self._gripper is not None:
            self._gripper.revive()
        try:
            self._driver.recover()
        finally:
            self._report()
        return "holding the measured posture"

    # Diagnostics

    def _report(self) -> None:
        """Report the state, and what it means, where that is due."""
        watchdog = self._driver.filter.watchdog
        if self._telling.is_due(self._driver.stamp, watchdog.state, watchdog.cause):
            self._tell()

    def _tell(self) -> None:
        watchdog = self._driver.filter.watchdog
        self.diagnostics.values.update(state=str(watchdog.state), last_error=self._driver.error)
        hand = "" if self._gripper is None else self._gripper.error
        lag = self._driver.clock.lag * 1e-6 if self._judges_clock else 0.0
        self.diagnostics.report(*condition(watchdog.state, watchdog.cause, hand, lag))

    def _on_statistics(self) -> None:
        values = self.diagnostics.values
        # What breaks after a stop leaves the state as it is.
        values.update(
            lost_cycles=self._driver.lost_cycles, commands=self._driver.commands, last_error=self._driver.error
        )
        values["clock_lag_ms"] = round(self._driver.clock.lag * 1e-6, 1)
        times = self._driver.times  # since the arm was taken under control
        values.update(cycles=times.count, cycle_rate_hz=round(times.rate, 1))
        for name, percent in (("p50", 50), ("p99", 99), ("max", 100)):
            values[f"cycle_{name}_ms"] = round(times.percentile(percent) * 1e3, 3)
        values["reply_p99_ms"] = round(self._driver.replies.percentile(99) * 1e3, 3)  # of the last second
        self._driver.replies.clear()
        values["overrun_ms"] = round(self._driver.overrun * 1e3, 1)
        limited = self._driver.filter.limited
        values.update({f"limited_{name}": count for name, count in limited.items() if count})
        self._tell()  # what is wrong with hand and clock changes without the state

    def _close_gripper(self) -> None:
        if self._gripper is not None:
            self._gripper.close()

    def destroy_node(self) -> None:
        """Bring the arm to rest and leave the robot."""
        self._driver.close()
        self._close_gripper()
        super().destroy_node()


def spin(node: FrankaDriver, spinner: Spinner) -> None:
    """The robot's cycle and the messages that have come meanwhile, in turn; timers and services every few
    cycles."""
    for number in count():
        wait = node.cycle()
        if wait or number % SERVED_EVERY == 0:
            spinner.spin_once(wait)
        else:
            spinner.poll()


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable `franka_driver`."""
    return run(FrankaDriver, args, spin=spin)


if __name__ == "__main__":
    raise SystemExit(main())
