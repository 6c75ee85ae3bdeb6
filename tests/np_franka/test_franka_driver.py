"""The driver cycle by cycle, against a robot that is nothing but its client; no hardware extra needed."""

from dataclasses import replace
from datetime import timedelta
from types import SimpleNamespace

import numpy as np
import pytest
import rclpy

from np_control.controller import ControllerConfig
from np_control.impedance import STIFFNESS_MAX
from np_control.realtime_input import HEARTBEAT_NS
from np_control.safety import Reason, Refusal, State
from np_control.safety.filter import REST_DAMPING
from np_control.trajectory import Trajectory
from np_description.force_reflex import FORCE_REFLEX
from np_description.panda import JOINT_NAMES, NOMINAL
from np_franka.arm import FrankaArm
from np_franka.checklist import Checklist, RobotFacts
from np_franka.client import MILLISECOND, ArmError, ArmReading, ConnectionLost, MotionAborted
from np_franka.driver import Driver
from np_franka.limits import FR3_LIMITS
from np_franka.nodes import franka_driver_node as module
from np_franka.onboard import Onboard

STEP = FR3_LIMITS.torque_rate * FR3_LIMITS.period  # Nm
LOAD = np.array([0, 30.0, 0, 0, 0, 0, 0])  # Nm
STILL = np.zeros(7)
EPOCH = 1_790_000_000_000_000_000  # ns


class Robot:
    """A client whose arm stands where it is. written: every torque that it was given, with whether it was the
    last; is_gone: whether it does not answer; facts: what it says of itself while it is not controlled."""

    def __init__(self):
        self.written, self.is_gone, self.time = [], False, 0
        self.facts_said = RobotFacts("Idle", "", NOMINAL.inertials["hand"].mass, 0.0)
        self.dq = STILL
        self.is_controlled = self.is_read = False

    def set_collision_behavior(self, torques, wrench):
        assert torques.shape == (7,) and wrench.shape == (6,)

    def facts(self):
        assert not self.is_controlled  # no client can be asked then
        return self.facts_said

    def start(self):
        self.is_controlled = True

    def read(self):
        if self.is_gone:
            raise ConnectionLost("connection to the robot: UDP receive: Timeout")
        self.time += MILLISECOND
        self.is_read = True
        return ArmReading(self.time, NOMINAL.ready, self.dq, STILL, STILL, STILL, STILL, np.zeros(6), "Move", "", 1.0)

    def write(self, torque, last):
        assert self.is_read  # a command is the reply to a state
        self.is_read = False
        self.written.append((torque, last))
        self.is_controlled = not last

    def clear_errors(self):
        pass

    def close(self):
        self.is_controlled = False

    @property
    def torques(self):
        """What it was told, (n, 7) Nm, from no torque on."""
        return np.array([STILL, *(torque for torque, _ in self.written)])


@pytest.fixture
def robot():
    return Robot()


def started(robot, *, drift=0.0, **changes):
    """A driver that holds this robot, whose clock gains `drift` s/s on the host's."""
    checklist = Checklist("none", timedelta(days=1), STIFFNESS_MAX, np.ones(7), FR3_LIMITS)
    reflex = FORCE_REFLEX
    arm = FrankaArm(lambda: robot, reflex.torques(FR3_LIMITS.torque), reflex.wrench())
    driver = Driver(
        arm, FR3_LIMITS, replace(checklist, **changes), host_time=lambda: EPOCH + round(robot.time / (1 + drift))
    )
    driver.start()
    return driver


def loaded(driver):
    """Let the arm rest under LOAD."""
    for _ in range(100):
        driver.offer(driver.stamp, JOINT_NAMES, NOMINAL.ready, STILL, LOAD)
        cycle = driver.cycle()
    np.testing.assert_array_equal(cycle.applied.torque, LOAD)


def test_torque_begins_at_none_again_after_a_lost_connection(robot):
    driver = started(robot)
    loaded(driver)
    robot.is_gone = True
    assert driver.cycle() is None and driver.state is State.FAULT
    robot.is_gone = False
    robot.written.clear()
    driver.recover()
    for _ in range(100):
        driver.cycle()
    assert driver.state is State.READY
    assert np.abs(robot.torques).max() < 1e-9  # at rest, in its own posture: there is nothing to pull back to


def test_torque_goes_on_from_what_is_applied_after_a_stop(robot):
    driver = started(robot)
    loaded(driver)
    driver.stop()
    driver.cycle()
    driver.recover()
    for _ in range(100):
        driver.cycle()
    assert np.abs(np.diff(robot.torques, axis=0)).max() <= STEP + 1e-9
    assert np.abs(robot.torques[-1]).max() < 1e-9


def test_every_recovery_is_checked_and_none_while_the_arm_moves(robot):
    driver = started(robot)
    driver.stop()
    driver.checklist = replace(driver.checklist, calibration="")  # as if the file were gone
    robot.dq = np.full(7, 0.2)
    driver.cycle()
    with pytest.raises(Refusal, match="still moves"):
        driver.recover()
    robot.dq = STILL
    driver.cycle()
    with pytest.raises(ArmError, match="no calibration"):
        driver.recover()
    assert driver.state is State.STOPPED and driver.arm.is_controlled
    driver.checklist = replace(driver.checklist, calibration="none")
    driver.recover()
    assert driver.state is State.READY


@pytest.mark.parametrize("drift", [-100e-6, 100e-6])
def test_stamps_follow_the_hosts_clock_and_never_go_back(robot, drift):
    driver = started(robot, drift=drift)
    stamps = [driver.stamp, *(driver.cycle().stamp for _ in range(8000))]
    assert (np.diff(stamps) > 0).all()
    assert abs(EPOCH + robot.time / (1 + drift) - driver.stamp) < 0.25e6  # 0.8 ms if it went on by itself
    robot.is_gone = True
    driver.cycle()
    robot.is_gone = False
    driver.recover()
    assert driver.stamp > stamps[-1]


@pytest.mark.parametrize("speed", [0.0, 0.2], ids=["at rest", "never at rest"])
def test_the_end_takes_torque_back_no_faster_than_ever(robot, speed, monkeypatch):
    monkeypatch.setattr("np_franka.driver.REST_TIMEOUT", 0.2)
    driver = started(robot)
    loaded(driver)
    robot.dq = np.full(7, speed)
    driver.close()
    assert [last for _, last in robot.written].index(True) == len(robot.written) - 1
    assert np.abs(np.diff(robot.torques, axis=0)).max() <= STEP + 1e-9
    assert not robot.torques[-1].any() and not driver.arm.is_connected


def test_the_end_brakes_an_arm_that_moves_and_lets_go_once_it_rests(robot, monkeypatch):
    driver, read = started(robot), robot.read
    robot.dq = np.full(7, 0.4)

    def rolls_out():
        robot.dq = 0.98 * robot.dq
        return read()

    monkeypatch.setattr(robot, "read", rolls_out)
    driver.close()
    assert np.abs(robot.dq).max() < FR3_LIMITS.rest_speed and not driver.arm.is_connected
    assert (robot.torques.min(axis=0) < -0.5 * REST_DAMPING * 0.4).all() and (robot.torques <= 0).all()


def test_the_end_of_a_robot_that_is_gone_does_not_wait_for_it(robot):
    driver = started(robot)
    loaded(driver)
    robot.is_gone = True
    driver.close()
    assert not driver.arm.is_connected


def test_an_arm_that_nobody_has_connected_is_neither_connected_nor_controlled(robot):
    arm = FrankaArm(lambda: robot, STILL, np.zeros(6))
    assert not arm.is_connected and not arm.is_controlled
    for act in (arm.facts, arm.start, arm.read, arm.clear_errors):
        with pytest.raises(ArmError, match="not connected to the robot"):
            act()


def test_an_arm_that_is_connected_again_leaves_its_first_connection():
    """A robot has one client at a time."""
    clients = []

    class Exclusive(Robot):
        def close(self):
            clients.remove(self)

    def connect():
        assert not clients
        clients.append(Exclusive())
        return clients[0]

    arm = FrankaArm(connect, STILL, np.zeros(6))
    for _ in range(2):
        arm.connect()
        assert arm.is_connected and not arm.is_controlled and len(clients) == 1


def test_a_driver_counts_commands_and_lost_cycles_and_says_what_broke_last(robot):
    driver = started(robot)
    assert (driver.commands, driver.lost_cycles, driver.error) == (0, 0, "")
    for n in range(3):
        driver.offer(driver.stamp, JOINT_NAMES, NOMINAL.ready, STILL, STILL)
        assert driver.commands == n + 1
        cycle = driver.cycle()
        assert cycle.stamp == driver.stamp and cycle.reading.time == robot.time
        assert (cycle.answer, cycle.refusal, cycle.clamped) == (None, None, False)
    assert (driver.lost_cycles, driver.times.count) == (0, 2)  # of cycles between two states
    robot.time += 4 * MILLISECOND
    driver.cycle()
    assert driver.lost_cycles == 4
    driver.stop()
    driver.cycle()
    driver.recover()
    assert driver.times.count == 0  # since it recovered
    robot.is_gone = True
    assert driver.cycle() is None and "UDP receive: Timeout" in driver.error and driver.state is State.FAULT
    robot.is_gone = False
    assert driver.cycle() is None and not driver.arm.is_connected  # nobody connects unasked


def test_the_answers_of_a_controller_on_board_are_applied_and_its_refusals_told_once(robot):
    driver = started(robot)
    driver.onboard = Onboard(ControllerConfig(), FR3_LIMITS, 300 * MILLISECOND)
    cycle = driver.cycle()
    assert (cycle.answer, cycle.refusal, driver.commands) == (None, None, 0)  # nothing to follow
    for phase in ("pre", "approach"):
        driver.onboard.phase(phase)
    driver.onboard.trajectory(Trajectory(np.zeros(1), NOMINAL.ready[None] + 0.01, np.zeros((1, 7))))
    for n in range(1, 4):
        cycle = driver.cycle()
        assert cycle.refusal is None and driver.commands == n and cycle.applied.state is State.MOVING
        np.testing.assert_array_equal(cycle.applied.position, cycle.answer.position)
    cycles = [driver.cycle() for _ in range(HEARTBEAT_NS // MILLISECOND + 5)]
    (lost,) = [cycle for cycle in cycles if cycle.refusal]
    assert lost.refusal.reason is Reason.HEARTBEAT and lost.answer is None
    assert cycles[-1].answer is not None and driver.state is State.MOVING  # the arm is held


def test_a_driver_measures_its_replies_and_the_work_beyond_a_cycle(robot, monkeypatch):
    """The host's clock moves only while the driver thinks: 0.4 ms, then 30 ms."""
    now = [0.0]
    monkeypatch.setattr("np_franka.driver.monotonic", lambda: now[0])
    driver = started(robot)
    thinks = iter([0.0004, 0.0004, 0.03])

    def take(torque, last):
        now[0] += next(thinks)
        robot.written.append((torque, last))

    monkeypatch.setattr(robot, "write", take)
    for _ in range(3):
        driver.cycle()
    assert (driver.replies.count, driver.replies.longest) == (3, pytest.approx(0.03))
    assert driver.replies.percentile(50) == pytest.approx(0.0004, abs=2e-5)
    assert driver.overrun == 0.0  # the longest one has not ended
    monkeypatch.setattr(robot, "write", lambda torque, last: None)
    driver.cycle()
    assert driver.overrun == pytest.approx(0.029)


@pytest.mark.parametrize("failing, taken", [("write", True), ("start", False)])
def test_a_robot_that_takes_no_torque_is_at_fault_and_still_read(robot, failing, taken, monkeypatch):
    def refuse(*arguments):
        robot.is_controlled = False
        raise MotionAborted("reflex")

    if not taken:
        monkeypatch.setattr(robot, failing, refuse)
    driver = started(robot)
    assert driver.state is (State.READY if taken else State.FAULT)
    monkeypatch.setattr(robot, failing, refuse)
    driver.cycle()
    assert driver.state is State.FAULT and driver.error == "reflex" and driver.filter.watchdog.cause == "reflex"
    assert driver.arm.is_connected and not driver.arm.is_controlled
    before = len(robot.written)
    cycle = driver.cycle()
    assert not cycle.applied.torque.any() and cycle.applied.state is State.FAULT and len(robot.written) == before
    assert cycle.clamped is False
    if not taken:
        with pytest.raises(ArmError, match="reflex"):
            driver.recover()
        assert driver.state is State.FAULT and driver.error == "reflex"
    monkeypatch.undo()
    driver.recover()
    assert driver.state is State.READY and driver.arm.is_controlled


def test_a_robot_that_must_not_move_is_connected_at_fault_and_asked_for_as_long_as_states_settle(robot, monkeypatch):
    times = iter(np.arange(0.0, 9.0, 0.25))
    monkeypatch.setattr("np_franka.arm.monotonic", lambda: next(times))
    asked = []
    robot.facts_said = replace(robot.facts_said, mode="Guiding")
    monkeypatch.setattr(robot, "facts", lambda: asked.append(0) or robot.facts_said)
    driver = started(robot)
    assert driver.state is State.FAULT and "mode is Guiding" in driver.error
    assert len(asked) == 2  # until 0.25 and 0.5 s, which is the deadline
    assert driver.arm.is_connected and not driver.arm.is_controlled and not robot.written
    robot.facts_said = replace(robot.facts_said, mode="Idle")
    driver.recover()
    assert driver.state is State.READY and len(asked) == 3


@pytest.fixture
def node(graph, robot, monkeypatch):
    """The node before its first cycle."""
    for key, value in graph.environment.items():
        monkeypatch.setenv(key, value)
    driver = started(robot)
    settings = SimpleNamespace(
        robot="fr3",
        hostname="none",
        control="topic",
        calibration="none",
        has_gripper=False,
        realtime="ignore",
        priority=0,
    )
    monkeypatch.setattr(module, "declare", lambda node: (settings, driver))
    monkeypatch.setattr(driver, "start", lambda: None)  # it has been
    rclpy.init(domain_id=graph.domain_id)
    made = module.FrankaDriver()
    made.driver = driver
    yield made
    made.destroy_node()
    rclpy.try_shutdown()


def test_the_numbers_that_show_why_cycles_are_lost_are_published(node, robot):
    for _ in range(3):
        node.cycle()
    robot.time += 6 * MILLISECOND
    node.cycle()
    node._on_statistics()
    values = node.diagnostics.values
    assert values["lost_cycles"] == 6 and values["overrun_ms"] == round(node.driver.overrun * 1e3, 1)
    assert values["reply_p99_ms"] > 0.0 and node.driver.replies.count == 0  # those of the last second
    published = {pair.key: pair.value for pair in node.diagnostics._status().status[0].values}
    assert {"lost_cycles", "overrun_ms", "reply_p99_ms", "processor_wait_ms", "commands"} <= set(published)
