"""The controller's node: the test is the backend, or the sim bridge is."""

import subprocess
import sys

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory

from np_common.rotations import quaternion_from_matrix
from np_control.impedance import STIFFNESS_MIN
from np_control.kinematics import forward_kinematics, pose_distance
from np_control.safety import LIMITS
from np_description.message_arrays import joint_state_arrays, stamp_nanoseconds
from np_description.panda import BASE_FRAME, JOINT_NAMES, NOMINAL, STATE_NAMES
from np_description.phases import PhaseState
from np_ros import qos
from np_ros.messages import gains_message, joint_state_message, pose_message, trajectory_message
from np_ros.phases import phase_message

PERIOD = LIMITS.period_ns
TICK = 50 * PERIOD
GAINS = np.stack([2 * STIFFNESS_MIN, np.ones(7)])
POSITION, ROTATION = forward_kinematics(NOMINAL.ready)
QUATERNION = quaternion_from_matrix(ROTATION)


@pytest.fixture
def start(graph, probe):
    """Starts the node with these parameters, everything matched."""

    def started(**parameters):
        inputs = [
            ("joint_states", JointState, qos.LOCKSTEP),
            ("episode/tick", DiagnosticArray, qos.LOCKSTEP),
            ("joint_trajectory", JointTrajectory, qos.EVENT),
            ("episode/phase", DiagnosticArray, qos.LATCHED),
            ("target_gains", Float64MultiArray, qos.LOCKSTEP),
            ("target_pose", PoseStamped, qos.LOCKSTEP),
        ]
        for topic, kind, profile in inputs:
            probe.advertise(topic, kind, profile)
        probe.collect("effort_command", JointState)
        probe.collect("diagnostics", DiagnosticArray, qos.EVENT)
        probe.wait_until_ready({graph.run("np_control", "joint_impedance", parameters)})

    return started


@pytest.fixture
def state(probe):
    """Publishes the state of a stamp: the ready posture, or another."""

    def publish(stamp, joints=NOMINAL.ready, fingers=(0.0, 0.0)):
        position, still = [*joints, *fingers], np.zeros(9)
        probe.publish("joint_states", joint_state_message(stamp, STATE_NAMES, position, still, still))

    return publish


def plan(stamp, times, goal):
    """A trajectory of two points at rest, from ready."""
    return trajectory_message(stamp, JOINT_NAMES, times, [NOMINAL.ready, goal], np.zeros((2, 7)))


def answers(probe):
    return [stamp_nanoseconds(message.header.stamp) for message in probe.messages["effort_command"]]


def answered(probe, stamp):
    probe.wait_until(lambda: stamp in answers(probe), what=f"the answer to {stamp} ns")
    last = [m for m in probe.messages["effort_command"] if stamp_nanoseconds(m.header.stamp) == stamp][-1]
    return joint_state_arrays(last, JOINT_NAMES)


def is_counted(probe, key):
    return any(
        pair.key == key and int(pair.value) >= 1
        for array in probe.messages["diagnostics"]
        for status in array.status
        for pair in status.values
    )


def counted(probe, key):
    probe.wait_until(lambda: is_counted(probe, key), what=f"{key} in diagnostics")


def test_the_arm_is_held_where_it_was_found(start, state, probe):
    start(tick_barrier=False)
    state(10 * PERIOD)
    position, velocity, effort = answered(probe, 10 * PERIOD)
    np.testing.assert_array_equal(position, NOMINAL.ready)
    np.testing.assert_allclose([velocity, effort], 0, atol=1e-12)
    moved = NOMINAL.ready + 0.001
    state(11 * PERIOD, moved)
    position, _, effort = answered(probe, 11 * PERIOD)
    np.testing.assert_array_equal(position, NOMINAL.ready)
    assert (effort < 0).all()


def test_every_state_is_answered_and_a_repeated_one_alike(start, state, probe):
    start(tick_barrier=False)
    stamps = [k * PERIOD for k in range(1, 80)]
    for k, stamp in enumerate(stamps):
        state(stamp, NOMINAL.ready + 1e-4 * np.sin(k))
    answered(probe, stamps[-1])
    assert answers(probe) == stamps
    first = answered(probe, stamps[-1])
    state(stamps[-1], NOMINAL.ready + 1e-4 * np.sin(len(stamps) - 1))
    probe.wait_until(lambda: len(probe.messages["effort_command"]) == len(stamps) + 1)
    np.testing.assert_array_equal(answered(probe, stamps[-1]), first)


def test_bad_states_are_counted_and_the_next_good_one_is_answered(start, state, probe):
    start(tick_barrier=False)
    state(PERIOD, NOMINAL.ready * np.nan)
    counted(probe, "refused_finite")
    probe.publish("joint_states", joint_state_message(PERIOD, STATE_NAMES[::-1], *np.zeros((3, 9))))
    counted(probe, "refused_names")
    state(2 * PERIOD)
    answered(probe, 2 * PERIOD)
    assert answers(probe) == [2 * PERIOD]


def waits_for(probe, topic):
    """Until the controller says that it waits for the topic, in its newest diagnostics."""

    def said():
        last = next((s for array in reversed(probe.messages["diagnostics"]) for s in array.status), None)
        return last is not None and any(p.key == "waiting_for" and p.value == topic for p in last.values)

    probe.wait_until(said, what=f"the controller to wait for {topic}")


def test_a_tick_state_waits_for_tick_then_trajectory_then_target(start, state, probe):
    """Each input is sent only after the node has been shown not to answer without it."""
    start()

    state(TICK)
    waits_for(probe, "episode/tick")
    probe.publish("episode/tick", phase_message(PhaseState("approach"), TICK))
    waits_for(probe, "joint_trajectory")
    assert answers(probe) == []
    goal = NOMINAL.ready + 0.01  # rad, which an arm that stands may be led by without pressing too hard
    probe.publish("joint_trajectory", plan(TICK, [0.0, 0.05], goal), qos.EVENT)
    np.testing.assert_array_equal(answered(probe, TICK)[0], NOMINAL.ready)
    stamps = range(TICK + PERIOD, 2 * TICK, PERIOD)
    for stamp in stamps:
        state(stamp)
    answered(probe, stamps[-1])
    np.testing.assert_array_equal(answered(probe, TICK + 25 * PERIOD)[0], goal)

    state(2 * TICK)
    probe.publish("episode/tick", phase_message(PhaseState("post"), 2 * TICK))
    waits_for(probe, "target_pose")
    probe.publish("target_pose", pose_message(2 * TICK, BASE_FRAME, POSITION + [0, 0, 0.01], QUATERNION))
    waits_for(probe, "target_gains")
    assert answers(probe)[-1] == stamps[-1]
    probe.publish("target_gains", gains_message(GAINS))
    np.testing.assert_array_equal(answered(probe, 2 * TICK)[0], goal)  # not before the policy's latency
    for k in range(1, 11):
        state(2 * TICK + k * PERIOD)
    np.testing.assert_array_equal(answered(probe, 2 * TICK + 9 * PERIOD)[0], goal)
    joints = answered(probe, 2 * TICK + 10 * PERIOD)[0]
    distance, angle = pose_distance(joints, POSITION + [0, 0, 0.01], ROTATION)
    assert distance < 1e-4 and angle < 1e-3


def test_after_a_restart_of_the_backend_what_was_said_to_the_one_before_is_no_answer(start, state, probe):
    """Its first episode begins at the same stamp, and the plan of before was made for another task."""
    start()
    state(TICK)
    probe.publish("episode/tick", phase_message(PhaseState("approach"), TICK))
    probe.publish("joint_trajectory", plan(TICK, [0.0, 1.0], NOMINAL.ready + 0.02), qos.EVENT)
    answered(probe, TICK)
    probe.messages["effort_command"].clear()
    probe.messages["diagnostics"].clear()
    state(0)
    waits_for(probe, "episode/tick")
    probe.publish("episode/tick", phase_message(PhaseState("pre"), 0))
    answered(probe, 0)
    state(TICK)
    goal = NOMINAL.ready - 0.01
    probe.publish("episode/tick", phase_message(PhaseState("approach"), TICK))
    probe.publish("joint_trajectory", plan(TICK, [0.0, 0.05], goal), qos.EVENT)
    answered(probe, TICK)
    for stamp in range(TICK + PERIOD, 2 * TICK, PERIOD):
        state(stamp)
    np.testing.assert_array_equal(answered(probe, 2 * TICK - PERIOD)[0], goal)


def test_what_an_episode_still_asks_for_after_a_reset_is_refused(start, state, probe):
    """It hears of the reset after the first states of the new task, and has ticked by then: policy and plan have answered."""
    start()
    state(TICK)
    probe.publish("episode/tick", phase_message(PhaseState("post"), TICK))
    for _ in range(2):  # before the reset, and after it
        stamp = TICK if not probe.messages["effort_command"] else 3 * TICK
        state(stamp)
        probe.publish("episode/tick", phase_message(PhaseState("post"), stamp))
        probe.publish("target_pose", pose_message(stamp, BASE_FRAME, POSITION + [0, 0, 0.01], QUATERNION))
        probe.publish("target_gains", gains_message(GAINS))
        answered(probe, stamp)
    counted(probe, "refused_state")
    for k in range(1, 30):
        state(3 * TICK + k * PERIOD)
    position, *_, torque = answered(probe, 3 * TICK + 29 * PERIOD)
    np.testing.assert_array_equal(position, NOMINAL.ready)
    assert not np.any(torque)


def test_the_plan_of_an_episode_that_begins_after_a_reset_in_an_approach_is_followed(start, state, probe):
    """In lockstep phase pre has no tick: the tick before the new approach was of the approach that the reset ended."""
    start()
    for first, turn in ((TICK, 0.01), (3 * TICK, -0.01)):
        goal = NOMINAL.ready + turn
        state(first)
        probe.publish("episode/tick", phase_message(PhaseState("approach"), first))
        probe.publish("joint_trajectory", plan(first, [0.0, 0.05], goal), qos.EVENT)
        answered(probe, first)
        for stamp in range(first + PERIOD, first + TICK, PERIOD):
            state(stamp)
        np.testing.assert_array_equal(answered(probe, first + TICK - PERIOD)[0], goal)


def test_a_refused_target_is_an_answer_that_changes_nothing(start, state, probe):
    start()
    state(TICK)
    probe.publish("episode/tick", phase_message(PhaseState("post"), TICK))
    probe.publish("target_gains", gains_message(GAINS))
    broken = pose_message(TICK, BASE_FRAME, POSITION, QUATERNION)
    broken.pose.position.x = float("nan")
    probe.publish("target_pose", broken)
    np.testing.assert_array_equal(answered(probe, TICK)[0], NOMINAL.ready)
    counted(probe, "refused_finite")


def test_a_pose_without_gains_is_refused_in_real_time(start, state, probe):
    start(mode="realtime")

    def refused():  # best effort may lose any one of them
        state(TICK)
        probe.publish("target_pose", pose_message(TICK, BASE_FRAME, POSITION, QUATERNION))
        return is_counted(probe, "refused_unpaired")

    probe.wait_until(refused, what="the pose to be refused")


def test_a_bad_trajectory_leaves_the_arm_where_it_is(start, state, probe):
    start(tick_barrier=False)
    state(PERIOD)
    answered(probe, PERIOD)
    probe.publish("joint_trajectory", plan(PERIOD, [0.0, 0.1], NOMINAL.ready + 1), qos.EVENT)
    counted(probe, "refused_velocity")
    state(2 * PERIOD)
    np.testing.assert_array_equal(answered(probe, 2 * PERIOD)[0], NOMINAL.ready)


def test_in_a_fault_the_target_goes_along_with_the_arm(start, state, probe):
    start(tick_barrier=False)
    state(PERIOD)
    answered(probe, PERIOD)
    say(probe, "fault", "test")
    stamp = PERIOD
    sagged = NOMINAL.ready + 0.003

    def followed():
        nonlocal stamp
        stamp += PERIOD
        state(stamp, sagged)
        return (answered(probe, stamp)[0] == sagged).all()

    probe.wait_until(followed, what="the target to go along")


class FollowingArm:
    """Goes where the controller wants it, a period at a time. Nobody waits for ticks, as in real time. heartbeat: sent with each state."""

    def __init__(self, start, state, probe, **parameters):
        start(tick_barrier=False, **parameters)
        self._state, self._probe, self.stamp, self.joints = state, probe, 0, NOMINAL.ready
        self.heartbeat = ""
        self.step()  # the first state is a beginning, which an episode has to come after

    def step(self, periods=1):
        """The joint target after so many periods."""
        for _ in range(periods):
            self.stamp += PERIOD
            self._probe.messages["effort_command"].clear()
            if self.heartbeat:
                self._probe.publish("episode/heartbeat", String(data=self.heartbeat))
            self._state(self.stamp, self.joints)
            self.joints = answered(self._probe, self.stamp)[0]
        return self.joints

    def until(self, condition, what):
        """Go on until the condition holds, asked every tenth period."""
        self._probe.wait_until(lambda: condition(self.step(10)), what=what)


@pytest.fixture
def arm(start, state, probe):
    return FollowingArm(start, state, probe)


def say(probe, phase, reason=""):
    """Two states later the node has heard it."""
    probe.publish("episode/phase", phase_message(PhaseState(phase, reason)), qos.LATCHED)
    probe.wait_until(lambda: probe.all_acknowledged("episode/phase"))


def test_the_end_of_an_episode_stops_an_arm_on_its_way_and_late_plans_are_refused(arm, probe):
    goal = NOMINAL.ready + 0.4
    for phase in ("pre", "approach"):
        say(probe, phase)
        arm.step(2)
    probe.publish("joint_trajectory", plan(0, [0.0, 2.0], goal), qos.EVENT)
    arm.until(lambda joints: (joints > NOMINAL.ready + 0.1).all(), "the way")
    say(probe, "failed", "approach: stopped on request")
    rest = comes_to_rest(arm)
    assert (rest < NOMINAL.ready + 0.3).all()
    probe.publish(
        "joint_trajectory", trajectory_message(0, JOINT_NAMES, [0.0, 1.0], [rest, goal], np.zeros((2, 7))), qos.EVENT
    )
    counted(probe, "refused_state")
    np.testing.assert_array_equal(arm.step(50), rest)


def comes_to_rest(arm):
    """Its joints then."""
    before = None

    def rests(joints):
        nonlocal before
        is_still, before = before is not None and (joints == before).all(), joints
        return is_still

    arm.until(rests, "rest")
    return arm.joints


def test_without_heartbeats_an_arm_on_its_way_comes_to_rest(start, state, probe):
    probe.advertise("episode/heartbeat", String)
    arm = FollowingArm(start, state, probe, mode="realtime")
    for arm.heartbeat in ("pre", "approach"):
        say(probe, arm.heartbeat)
        arm.step(2)
    probe.publish("joint_trajectory", plan(0, [0.0, 2.0], NOMINAL.ready + 0.4), qos.EVENT)
    arm.until(lambda joints: (joints > NOMINAL.ready + 0.1).all(), "the way")
    arm.heartbeat = ""
    assert (comes_to_rest(arm) < NOMINAL.ready + 0.3).all()
    counted(probe, "refused_heartbeat")


def test_after_a_fault_the_arm_is_held_again(arm, state, probe):
    arm.step()
    say(probe, "fault", "test")
    pushed = NOMINAL.ready + 0.003

    def goes_along(_):
        arm.joints = pushed
        return (arm.step() == pushed).all()

    arm.until(goes_along, "the target to go along")
    say(probe, "idle")

    def holds(_):
        before = arm.step()
        arm.joints = before + 0.002  # somebody pushes
        return (arm.step() == before).all()

    arm.until(holds, "the arm to be held")
    state(arm.stamp + PERIOD, arm.joints + 0.002)
    assert (answered(probe, arm.stamp + PERIOD)[2] < 0).all()


def test_an_arm_that_comes_back_in_the_middle_of_an_episode_is_not_moved(arm, probe):
    """Its driver was restarted: the policy went on for the one before."""
    for phase in ("pre", "post"):
        say(probe, phase)
        arm.step(10)
    arm.stamp += 10**9
    arm.step()
    is_left_alone(arm, probe)


def test_a_controller_that_comes_in_the_middle_of_an_episode_moves_nothing(arm, probe):
    """It was restarted, or was on board of a driver that was; the phase, latched, it hears after its first state."""
    say(probe, "post")
    arm.step(10)
    is_left_alone(arm, probe)


def is_left_alone(arm, probe):
    """Whatever the policy asks for."""

    def refused(_):
        probe.publish("target_gains", gains_message(GAINS))
        probe.publish("target_pose", pose_message(arm.stamp, BASE_FRAME, POSITION + [0.02, 0, 0], QUATERNION))
        return is_counted(probe, "refused_state")

    arm.until(refused, "the target to be refused")
    np.testing.assert_array_equal(arm.step(30), NOMINAL.ready)


def test_with_the_sim_bridge_the_arm_arrives(graph, probe, tmp_path):
    """Lockstep, no episode: the bridge's physics carries the arm along a trajectory to its end."""
    goal = NOMINAL.ready + [0.3, 0.2, -0.2, 0.2, 0.2, -0.2, 0.3]
    probe.collect("joint_states", JointState)
    probe.advertise("joint_trajectory", JointTrajectory, qos.EVENT)
    free = {"tick_barrier": False}
    probe.wait_until_ready(
        {
            graph.run("np_control", "joint_impedance", free),
            graph.run("np_sim_bridge", "sim_bridge", {**free, "camera": False}),
        }
    )
    probe.wait_until(lambda: len(probe.messages["joint_states"]) > 5, what="time to run")
    probe.publish("joint_trajectory", plan(0, [0.0, 1.0], goal), qos.EVENT)

    def error():
        return np.abs(joint_state_arrays(probe.messages["joint_states"][-1], STATE_NAMES)[0][:7] - goal).max()

    probe.wait_until(lambda: error() < 0.003, what="the arm to arrive")


def test_the_controller_does_not_import_torch():
    """Its start-up and its 500 Hz loop have no use for a deep learning library."""
    code = "import sys, np_control.nodes.joint_impedance_node; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
