"""The controller's node: the test is the backend, or the sim bridge is."""

import subprocess
import sys

import numpy as np
from impedance_tools import (
    GAINS,
    PERIOD,
    POSITION,
    QUATERNION,
    ROTATION,
    TICK,
    answered,
    answers,
    counted,
    is_counted,
    plan,
    publish_phase,
)
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from np_control.kinematics import pose_distance
from np_description.message_arrays import joint_state_arrays
from np_description.panda import BASE_FRAME, NOMINAL, STATE_NAMES
from np_description.phases import PhaseState
from np_ros import qos
from np_ros.messages import gains_message, joint_state_message, pose_message
from np_ros.phases import phase_message


def test_the_arm_is_held_where_it_was_found(start_controller, send_state, probe):
    start_controller(tick_barrier=False)
    send_state(10 * PERIOD)
    position, velocity, effort = answered(probe, 10 * PERIOD)
    np.testing.assert_array_equal(position, NOMINAL.ready)
    np.testing.assert_allclose([velocity, effort], 0, atol=1e-12)
    moved = NOMINAL.ready + 0.001
    send_state(11 * PERIOD, moved)
    position, _, effort = answered(probe, 11 * PERIOD)
    np.testing.assert_array_equal(position, NOMINAL.ready)
    assert (effort < 0).all()


def test_every_state_is_answered_and_a_repeated_one_alike(start_controller, send_state, probe):
    start_controller(tick_barrier=False)
    stamps = [k * PERIOD for k in range(1, 80)]
    for k, stamp in enumerate(stamps):
        send_state(stamp, NOMINAL.ready + 1e-4 * np.sin(k))
    answered(probe, stamps[-1])
    assert answers(probe) == stamps
    first = answered(probe, stamps[-1])
    send_state(stamps[-1], NOMINAL.ready + 1e-4 * np.sin(len(stamps) - 1))
    probe.wait_until(lambda: len(probe.messages["effort_command"]) == len(stamps) + 1)
    np.testing.assert_array_equal(answered(probe, stamps[-1]), first)


def test_bad_states_are_counted_and_the_next_good_one_is_answered(start_controller, send_state, probe):
    start_controller(tick_barrier=False)
    send_state(PERIOD, NOMINAL.ready * np.nan)
    counted(probe, "refused_finite")
    probe.publish("joint_states", joint_state_message(PERIOD, STATE_NAMES[::-1], *np.zeros((3, 9))))
    counted(probe, "refused_names")
    send_state(2 * PERIOD)
    answered(probe, 2 * PERIOD)
    assert answers(probe) == [2 * PERIOD]


def waits_for(probe, topic):
    """Until the controller says that it waits for the topic, in its newest diagnostics."""

    def said():
        last = next((s for array in reversed(probe.messages["diagnostics"]) for s in array.status), None)
        return last is not None and any(p.key == "waiting_for" and p.value == topic for p in last.values)

    probe.wait_until(said, what=f"the controller to wait for {topic}")


def test_a_tick_state_waits_for_tick_then_trajectory_then_target(start_controller, send_state, probe):
    """Each input is sent only after the node has been shown not to answer without it."""
    start_controller()

    send_state(TICK)
    waits_for(probe, "episode/tick")
    probe.publish("episode/tick", phase_message(PhaseState("approach"), TICK))
    waits_for(probe, "joint_trajectory")
    assert answers(probe) == []
    goal = NOMINAL.ready + 0.01  # rad, which an arm that stands may be led by without pressing too hard
    probe.publish("joint_trajectory", plan(TICK, [0.0, 0.05], goal), qos.EVENT)
    np.testing.assert_array_equal(answered(probe, TICK)[0], NOMINAL.ready)
    stamps = range(TICK + PERIOD, 2 * TICK, PERIOD)
    for stamp in stamps:
        send_state(stamp)
    answered(probe, stamps[-1])
    np.testing.assert_array_equal(answered(probe, TICK + 25 * PERIOD)[0], goal)

    send_state(2 * TICK)
    probe.publish("episode/tick", phase_message(PhaseState("post"), 2 * TICK))
    waits_for(probe, "target_pose")
    probe.publish("target_pose", pose_message(2 * TICK, BASE_FRAME, POSITION + [0, 0, 0.01], QUATERNION))
    waits_for(probe, "target_gains")
    assert answers(probe)[-1] == stamps[-1]
    probe.publish("target_gains", gains_message(GAINS))
    np.testing.assert_array_equal(answered(probe, 2 * TICK)[0], goal)  # not before the policy's latency
    for k in range(1, 11):
        send_state(2 * TICK + k * PERIOD)
    np.testing.assert_array_equal(answered(probe, 2 * TICK + 9 * PERIOD)[0], goal)
    joints = answered(probe, 2 * TICK + 10 * PERIOD)[0]
    distance, angle = pose_distance(joints, POSITION + [0, 0, 0.01], ROTATION)
    assert distance < 1e-4 and angle < 1e-3


def test_after_a_restart_of_the_backend_what_was_said_to_the_one_before_is_no_answer(
    start_controller, send_state, probe
):
    """Its first episode begins at the same stamp, and the plan of before was made for another task."""
    start_controller()
    send_state(TICK)
    probe.publish("episode/tick", phase_message(PhaseState("approach"), TICK))
    probe.publish("joint_trajectory", plan(TICK, [0.0, 1.0], NOMINAL.ready + 0.02), qos.EVENT)
    answered(probe, TICK)
    probe.messages["effort_command"].clear()
    probe.messages["diagnostics"].clear()
    send_state(0)
    waits_for(probe, "episode/tick")
    probe.publish("episode/tick", phase_message(PhaseState("pre"), 0))
    answered(probe, 0)
    send_state(TICK)
    goal = NOMINAL.ready - 0.01
    probe.publish("episode/tick", phase_message(PhaseState("approach"), TICK))
    probe.publish("joint_trajectory", plan(TICK, [0.0, 0.05], goal), qos.EVENT)
    answered(probe, TICK)
    for stamp in range(TICK + PERIOD, 2 * TICK, PERIOD):
        send_state(stamp)
    np.testing.assert_array_equal(answered(probe, 2 * TICK - PERIOD)[0], goal)


def test_what_an_episode_still_asks_for_after_a_reset_is_refused(start_controller, send_state, probe):
    """It hears of the reset after the first states of the new task, and has ticked by then: policy and plan have answered."""
    start_controller()
    send_state(TICK)
    probe.publish("episode/tick", phase_message(PhaseState("post"), TICK))
    for _ in range(2):  # before the reset, and after it
        stamp = TICK if not probe.messages["effort_command"] else 3 * TICK
        send_state(stamp)
        probe.publish("episode/tick", phase_message(PhaseState("post"), stamp))
        probe.publish("target_pose", pose_message(stamp, BASE_FRAME, POSITION + [0, 0, 0.01], QUATERNION))
        probe.publish("target_gains", gains_message(GAINS))
        answered(probe, stamp)
    counted(probe, "refused_state")
    for k in range(1, 30):
        send_state(3 * TICK + k * PERIOD)
    position, *_, torque = answered(probe, 3 * TICK + 29 * PERIOD)
    np.testing.assert_array_equal(position, NOMINAL.ready)
    assert not np.any(torque)


def test_the_plan_of_an_episode_that_begins_after_a_reset_in_an_approach_is_followed(
    start_controller, send_state, probe
):
    """In lockstep phase pre has no tick: the tick before the new approach was of the approach that the reset ended."""
    start_controller()
    for first, turn in ((TICK, 0.01), (3 * TICK, -0.01)):
        goal = NOMINAL.ready + turn
        send_state(first)
        probe.publish("episode/tick", phase_message(PhaseState("approach"), first))
        probe.publish("joint_trajectory", plan(first, [0.0, 0.05], goal), qos.EVENT)
        answered(probe, first)
        for stamp in range(first + PERIOD, first + TICK, PERIOD):
            send_state(stamp)
        np.testing.assert_array_equal(answered(probe, first + TICK - PERIOD)[0], goal)


def test_a_refused_target_is_an_answer_that_changes_nothing(start_controller, send_state, probe):
    start_controller()
    send_state(TICK)
    probe.publish("episode/tick", phase_message(PhaseState("post"), TICK))
    probe.publish("target_gains", gains_message(GAINS))
    broken = pose_message(TICK, BASE_FRAME, POSITION, QUATERNION)
    broken.pose.position.x = float("nan")
    probe.publish("target_pose", broken)
    np.testing.assert_array_equal(answered(probe, TICK)[0], NOMINAL.ready)
    counted(probe, "refused_finite")


def test_a_pose_without_gains_is_refused_in_real_time(start_controller, send_state, probe):
    start_controller(mode="realtime")

    def refused():  # best effort may lose any one of them
        send_state(TICK)
        probe.publish("target_pose", pose_message(TICK, BASE_FRAME, POSITION, QUATERNION))
        return is_counted(probe, "refused_unpaired")

    probe.wait_until(refused, what="the pose to be refused")


def test_a_bad_trajectory_leaves_the_arm_where_it_is(start_controller, send_state, probe):
    start_controller(tick_barrier=False)
    send_state(PERIOD)
    answered(probe, PERIOD)
    probe.publish("joint_trajectory", plan(PERIOD, [0.0, 0.1], NOMINAL.ready + 1), qos.EVENT)
    counted(probe, "refused_velocity")
    send_state(2 * PERIOD)
    np.testing.assert_array_equal(answered(probe, 2 * PERIOD)[0], NOMINAL.ready)


def test_in_a_fault_the_target_goes_along_with_the_arm(start_controller, send_state, probe):
    start_controller(tick_barrier=False)
    send_state(PERIOD)
    answered(probe, PERIOD)
    publish_phase(probe, "fault", "test")
    stamp = PERIOD
    sagged = NOMINAL.ready + 0.003

    def followed():
        nonlocal stamp
        stamp += PERIOD
        send_state(stamp, sagged)
        return (answered(probe, stamp)[0] == sagged).all()

    probe.wait_until(followed, what="the target to go along")


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
