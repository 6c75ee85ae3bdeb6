"""Our targets, gains and plans as controllers of ros2_control take them, by their rules."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from np_control.impedance import STIFFNESS_MAX, STIFFNESS_MIN, torque
from np_control.ros2_control import CRISP, JTC, as_controller_takes, check_trajectory, gain_parameters
from np_control.safety import LIMITS
from np_description.domains import CARD, sample_task
from np_description.message_arrays import BadMessage
from np_description.panda import JOINT_NAMES, NOMINAL, STATE_NAMES
from np_planning.approach import ApproachConfig, plan_approach
from np_planning.collision import CollisionModel
from np_planning.rrt import PlanningBudget
from np_ros import qos
from np_ros.messages import gains_message, joint_state_message, trajectory_message

FR3 = [name.replace("panda", "fr3") for name in JOINT_NAMES]


@given(st.lists(st.floats(0, 1), min_size=14, max_size=14), st.lists(st.floats(-0.1, 0.1), min_size=14, max_size=14))
def test_the_controllers_laws_with_these_gains_are_ours(shares, errors):
    kp = STIFFNESS_MIN + np.array(shares[:7]) * (STIFFNESS_MAX - STIFFNESS_MIN)
    rho = 0.5 + 1.5 * np.array(shares[7:])
    error, speed = np.array(errors[:7]), np.array(errors[7:])
    ours = torque(-error, speed, np.zeros(7), kp, rho, np.zeros(7))
    crisp = gain_parameters(CRISP, FR3, kp, rho)
    jtc = gain_parameters(JTC, FR3, kp, rho)
    np.testing.assert_allclose(
        np.array(crisp["nullspace.stiffness"]) * error - np.array(crisp["nullspace.damping"]) * speed, ours, atol=1e-12
    )
    p, d = (np.array([jtc[f"gains.{joint}.{part}"] for joint in FR3]) for part in "pd")
    np.testing.assert_allclose(p * error - d * speed, ours, atol=1e-12)


@pytest.fixture(scope="module")
def plan():
    """The topic's message for a real plan."""
    objekt, _ = sample_task(CARD, np.random.default_rng(0))
    goal = objekt.__class__(objekt.position + [0.0, 0.0, 0.02], np.array([0.0, 1.0, 0.0, 0.0]))
    config = ApproachConfig(budget=PlanningBudget(improve=100))
    found = plan_approach(CollisionModel(CARD), NOMINAL.ready, goal, 0.01, objekt, seed=0, config=config).trajectory
    return trajectory_message(5_000_000_000, JOINT_NAMES, found.times, found.positions, found.velocities)


def test_a_plan_of_the_approach_keeps_the_rules_once_it_is_translated(plan):
    check_trajectory(as_controller_takes(plan, FR3), FR3, NOMINAL.ready, LIMITS)
    assert plan.header.stamp.sec == 5 and len(plan.points[0].effort) == 7  # ours stays as it was


def test_what_breaks_a_rule_is_named(plan):
    def broken(change):
        message = as_controller_takes(plan, FR3)
        change(message)
        return message

    def shift_start(message, joint, by):
        message.points[0].positions = (NOMINAL.ready + by * np.eye(7)[joint]).tolist()

    def last_first(message):
        message.points = message.points[::-1]

    for match, change in {
        "joint_names: expected the names": lambda m: setattr(m, "joint_names", list(JOINT_NAMES)),
        "expected points, got none": lambda m: setattr(m, "points", []),
        "increasing": last_first,
        "expected 0, from now on": lambda m: setattr(m.header.stamp, "sec", 5),
        "effort: expected none": lambda m: setattr(m.points[0], "effort", [0.0] * 7),
        "rest at the end": lambda m: setattr(m.points[-1], "velocities", [0.0, -0.1, *[0.0] * 5]),
        "start within .* 0.0200 rad at fr3_joint1": lambda m: shift_start(m, 0, 0.02),
        "start within .* 0.0300 rad at fr3_joint7": lambda m: shift_start(m, 6, -0.03),
        "fr3_joint1 within its limits": lambda m: setattr(m.points[1], "positions", [3.0, *NOMINAL.ready[1:]]),
    }.items():
        with pytest.raises(BadMessage, match=match):
            check_trajectory(broken(change), FR3, NOMINAL.ready, LIMITS)


@pytest.mark.parametrize("limit", [LIMITS.position_lower, LIMITS.position_upper], ids=["lower", "upper"])
def test_a_plan_may_touch_the_limits(limit):
    plan = trajectory_message(0, JOINT_NAMES, [0.0, 9.0], np.stack([NOMINAL.ready, limit]), np.zeros((2, 7)))
    check_trajectory(as_controller_takes(plan, FR3), FR3, NOMINAL.ready, LIMITS)


def state(q):
    return joint_state_message(1_000_000, STATE_NAMES, np.concatenate([q, [0.0, 0.0]]), np.zeros(9), np.zeros(9))


def command(q):
    return joint_state_message(1_000_000, JOINT_NAMES, q, np.zeros(7), np.zeros(7))


GAINS = gains_message(np.stack([STIFFNESS_MAX, np.ones(7)]))


def test_crisp_gets_targets_and_gains(graph, probe):
    for name in ("nullspace.stiffness", "nullspace.damping"):
        probe.node.declare_parameter(name, Parameter.Type.DOUBLE_ARRAY, ParameterDescriptor())
    targets = probe.collect("target_joint", JointState, qos.EVENT)
    probe.advertise("effort_command", JointState), probe.advertise("target_gains", Float64MultiArray)
    graph.run("np_control", "ros2_control", {"controller_name": probe.node.get_name()})
    probe.wait_until(lambda: probe.matched("effort_command") and probe.matched("target_gains"))

    def heard():
        probe.publish("effort_command", command(NOMINAL.ready))
        probe.publish("target_gains", GAINS)
        return targets and probe.node.get_parameter_or("nullspace.stiffness").value is not None

    probe.wait_until(heard, what="a target and gains")
    assert list(targets[0].name) == FR3
    np.testing.assert_allclose(targets[0].position, NOMINAL.ready)
    np.testing.assert_allclose(probe.node.get_parameter("nullspace.stiffness").value, STIFFNESS_MAX)


def test_the_trajectory_controller_gets_the_plan_as_a_whole(graph, probe, plan):
    sent = probe.collect("jtc/joint_trajectory", JointTrajectory, qos.EVENT)
    for topic, kind in (("joint_states", JointState), ("effort_command", JointState)):
        probe.advertise(topic, kind)
    probe.advertise("joint_trajectory", JointTrajectory, qos.EVENT)
    graph.run("np_control", "ros2_control", {"controller": JTC, "controller_name": "jtc"})
    probe.wait_until(lambda: all(map(probe.matched, ("joint_states", "effort_command", "joint_trajectory"))))

    def heard():
        probe.publish("effort_command", command(NOMINAL.ready))
        probe.publish("joint_states", state(NOMINAL.ready))
        probe.publish("joint_trajectory", plan, qos.EVENT)
        return [message for message in sent if len(message.points) > 1]

    probe.wait_until(heard, what="the plan")
    assert list(heard()[0].joint_names) == FR3 and len(heard()[0].points) == len(plan.points)
