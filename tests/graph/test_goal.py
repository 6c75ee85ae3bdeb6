"""The node `goal`: one task for a real robot."""

import json
import os
import signal
from itertools import product

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger

from np_bringup.nodes.goal_node import MARGIN, goal_pose
from np_common.cli import INTERRUPTED
from np_common.rotations import yaw_quaternion
from np_description.domains import (
    BUMP,
    CARD,
    DOMAINS,
    GOAL_SLACK,
    WALL,
    check_goal,
    goal_region,
    is_success,
    pose_error,
    sample_task,
)
from np_description.message_arrays import pose_arrays, stamp_nanoseconds
from np_description.objects.scenarios import COUNT, make_fixed_task
from np_description.panda import BASE_FRAME, NOMINAL, STATE_NAMES
from np_ros import qos
from np_ros.messages import joint_state_message, pose_message
from np_ros.phases import phase_state
from np_ros.processes.supervisor import NodeDied


def test_the_goal_lies_on_the_table_on_the_backends_clock_and_is_latched(graph, probe):
    graph.run("np_bringup", "goal", {"x": 0.45, "y": 0.1, "yaw": 0.5, "stay": True})
    probe.advertise("joint_states", JointState)
    probe.wait_until(lambda: probe.matched("joint_states"), what="the node")
    goals = probe.collect("goal_pose", PoseStamped, qos.LATCHED)

    def send_state(stamp):
        probe.publish(
            "joint_states", joint_state_message(stamp, STATE_NAMES, [*NOMINAL.ready, 0, 0], np.zeros(9), np.zeros(9))
        )

    # A best-effort subscriber that we know of may not know of us yet, and miss the first.
    probe.wait_until(lambda: goals or send_state(7_000_000), what="the goal")
    send_state(9_000_000)
    probe.collect("goal_pose", PoseStamped, qos.LATCHED)
    probe.wait_until(lambda: len(goals) == 2, what="the goal, for who comes later")
    position, quaternion = pose_arrays(goals[0], BASE_FRAME)
    np.testing.assert_allclose(position, [0.45, 0.1, CARD.half_size[2]])
    np.testing.assert_allclose(quaternion, yaw_quaternion(np.asarray(0.5)))
    assert {stamp_nanoseconds(goal.header.stamp) for goal in goals} == {7_000_000}


def test_a_goal_ends_when_the_episode_has_it_and_not_before(graph, probe):
    """A start that comes before the goal would begin with another one, and end with it."""
    probe.advertise("joint_states", JointState)
    graph.run("np_policy", "episode", {"mode": "realtime"})
    # The backend's own goal, as `sim_bridge` publishes it at its start: of the same stamp.
    other = goal_pose(CARD, 0.5, -0.1, 0.0)
    probe.publish("goal_pose", pose_message(0, BASE_FRAME, other.position, other.quaternion), qos.LATCHED)
    seen = probe.collect("goal_keypoints", PointCloud2, qos.LATCHED)
    probe.wait_until(lambda: seen, what="the backend's goal to be taken")
    graph.run("np_bringup", "goal", {"x": 0.45, "y": 0.1})
    probe.wait_until(lambda: probe.matched("joint_states", 2), what="the node")
    state = joint_state_message(0, STATE_NAMES, [*NOMINAL.ready, 0, 0], np.zeros(9), np.zeros(9))
    probe.wait_until(lambda: graph.ended("goal") or probe.publish("joint_states", state), what="its end")
    # Said before the goal could end; on a busy machine we hear of its end first.
    probe.wait_until(lambda: len(seen) == 2, what="the goal to be taken")
    assert seen[0].data != seen[1].data


def test_a_goal_of_before_that_arrives_late_is_refused(graph, probe):
    """What is latched comes when its publisher is found: here of one that stands still while the next goal is given."""
    probe.advertise("joint_states", JointState)
    graph.run("np_bringup", "goal", {"x": 0.45, "y": 0.1, "stay": True, "limit": 3600.0})
    goals = probe.collect("goal_pose", PoseStamped, qos.LATCHED)
    state = joint_state_message(7_000_000, STATE_NAMES, [*NOMINAL.ready, 0, 0], np.zeros(9), np.zeros(9))
    probe.wait_until(lambda: goals or probe.publish("joint_states", state), what="the first goal")
    os.kill(graph.pid("goal"), signal.SIGSTOP)
    try:
        taken = probe.collect("goal_keypoints", PointCloud2, qos.LATCHED)
        graph.run("np_policy", "episode", {"mode": "realtime"})
        other = goal_pose(CARD, 0.5, -0.1, 0.0)
        message = pose_message(9_000_000, BASE_FRAME, other.position, other.quaternion)
        probe.publish("goal_pose", message, qos.LATCHED)
        probe.wait_until(lambda: taken, what="the newer goal to be taken")
    finally:
        os.kill(graph.pid("goal"), signal.SIGCONT)
    said = probe.collect("diagnostics", DiagnosticArray, qos.EVENT)

    def refused() -> bool:
        own = [status for array in said for status in array.status if status.name.lstrip("/") == "episode"]
        return any(pair.key == "refused_order" for status in own for pair in status.values)

    probe.wait_until(refused, what="the late goal to be refused")
    assert [stamp_nanoseconds(goal.header.stamp) for goal in taken] == [9_000_000]


def test_a_goal_that_nobody_takes_ends_with_words(graph, probe):
    graph.run("np_bringup", "goal", {"limit": 1.0})
    with pytest.raises(NodeDied, match="expected joint_states of a backend in this ROS_DOMAIN_ID within 1 s"):
        probe.wait_until(lambda: False)


def test_a_goal_of_another_domain_is_not_taken(graph, probe):
    probe.advertise("joint_states", JointState)
    graph.run("np_policy", "episode", {"mode": "realtime"})
    seen = probe.collect("goal_keypoints", PointCloud2, qos.LATCHED)
    graph.run("np_bringup", "goal", {"domain": "wall"})
    state = joint_state_message(0, STATE_NAMES, [*NOMINAL.ready, 0, 0], np.zeros(9), np.zeros(9))
    with pytest.raises(NodeDied, match="episode refused the goal .*expected one of card's goals"):
        probe.wait_until(lambda: probe.publish("joint_states", state), what="its end")
    assert not seen


@pytest.mark.parametrize("stays", [False, True])
def test_an_interrupted_goal_ends_with_0_only_if_it_was_taken(graph, probe, stays):
    probe.advertise("joint_states", JointState)
    graph.run("np_policy", "episode", {"mode": "realtime"}) if stays else None
    seen = probe.collect("goal_keypoints", PointCloud2, qos.LATCHED)
    heard = probe.collect("diagnostics", DiagnosticArray, qos.EVENT)
    graph.run("np_bringup", "goal", {"stay": True})
    probe.wait_until(lambda: any(a.status[0].name == "/goal" for a in heard), what="the node")
    if stays:
        state = joint_state_message(0, STATE_NAMES, [*NOMINAL.ready, 0, 0], np.zeros(9), np.zeros(9))
        probe.wait_until(lambda: seen or probe.publish("joint_states", state), what="the goal to be taken")
        log = graph.log_directory / "goal.log"
        probe.wait_until(lambda: "goal taken" in log.read_text(), what="the word of it")
    assert graph.kill("goal", signal.SIGINT) == (0 if stays else INTERRUPTED)


def test_run_answers_with_the_outcome(graph, probe):
    """And keeps nobody else's service waiting: it is `stop` that ends this one."""
    phases = probe.collect("episode/phase", DiagnosticArray, qos.LATCHED)
    probe.wait_until_ready({graph.run("np_policy", "episode", {"mode": "realtime", "silence": 60.0})})
    answer = probe.node.create_client(Trigger, "episode/run")
    probe.wait_until(answer.service_is_ready)
    future = answer.call_async(Trigger.Request())
    probe.wait_until(lambda: phases and phase_state(phases[-1]).phase == "pre", what="the start")
    assert not (refused := probe.call("episode/run")).success and "under way" in refused.message
    assert not future.done()
    assert probe.call("episode/stop").success
    probe.wait_until(future.done, what="the answer")
    assert not future.result().success
    assert json.loads(future.result().message) == {"phase": "failed", "reason": "pre: stopped on request"}


def test_a_goal_that_nobody_was_trained_for_is_refused(graph, probe):
    graph.run("np_bringup", "goal", {"x": 0.9})
    with pytest.raises(NodeDied, match="expected one of card's goals"):
        probe.wait_until(lambda: False)


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=list(DOMAINS))
def test_every_goal_that_is_drawn_can_be_asked_for(domain):
    """By x, y, yaw and the quarter turns before it, some combination of which gives the very pose."""
    rng = np.random.default_rng(0)
    turns = range(4) if domain is BUMP else range(1)
    yaws = np.linspace(-np.pi, np.pi, 73) if domain is not WALL else [0.0]
    for _ in range(12):
        _, goal = sample_task(domain, rng)
        tried = (goal_pose(domain, *goal.position[:2], yaw, *turn) for turn in product(turns, turns) for yaw in yaws)
        errors = (pose_error(p.position, p.quaternion, goal.position, goal.quaternion) for p in tried)
        assert any(distance < 1e-9 and is_success(domain, distance, angle) for distance, angle in errors)


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=list(DOMAINS))
def test_a_goal_is_its_own_domains_alone(domain):
    rng = np.random.default_rng(1)
    for _ in range(20):
        check_goal(domain, sample_task(domain, rng)[1])
    for other in DOMAINS.values():
        if other is not domain:
            with pytest.raises(ValueError, match=f"expected one of {domain.name}'s goals"):
                check_goal(domain, sample_task(other, rng)[1])
    for number in range(1, COUNT + 1):
        check_goal(domain, make_fixed_task(domain, number)[1])


def test_a_command_asks_for_goals_of_its_region_and_a_backend_may_be_beside_it_by_a_slack():
    edge = {"x": CARD.goals[0].x[1] + 0.001, "y": 0.0}
    assert goal_region(CARD, edge, GOAL_SLACK) is CARD.goals[0]
    for name, value in (("x", edge["x"]), ("surface", 0.01), ("yaw", 4.0)):
        with pytest.raises(ValueError, match=f"one of card's goals .*surface 0.0 m.*got .*{name} {value:.3f}"):
            goal_region(CARD, {"x": 0.5, "y": 0.0, name: value}, {**MARGIN, "surface": 0.0})


@pytest.mark.parametrize(
    "domain, arguments, text",
    [
        (CARD, (0.9, 0.0, 0.0), "goals .*got x 0.9"),
        (WALL, (0.62, -0.1, 0.0), "one of wall's goals"),
        (WALL, (0.62, 0.1, 1.0), "yaw 1.00"),
        (BUMP, (0.5, 0.07, 0.0), "one of bump's goals"),
        (CARD, (0.5, 0.0, 0.0, 1, 0), "no roll_turns and pitch_turns for card"),
    ],
)
def test_what_a_goal_cannot_be_is_named(domain, arguments, text):
    with pytest.raises(ValueError, match=text):
        goal_pose(domain, *arguments)
