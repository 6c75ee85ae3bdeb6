"""The conductor between a backend that is the test and the node `episode`: what comes late, all at once, or to others first."""

import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from graph_tools import TIMEOUT, Apart
from rclpy.duration import Duration
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from np_description.domains import CARD, Pose, sample_task
from np_description.panda import BASE_FRAME
from np_description.phases import PhaseState
from np_description.scene import CAMERA_NAME
from np_evaluation.nodes.episode_runner_node import EpisodeRunner
from np_perception.pose_estimation import project_keypoints
from np_ros import qos
from np_ros.messages import keypoints_message, pose_message
from np_ros.phases import phase_message

TICK = 100_000_000
START, GOAL = sample_task(CARD, np.random.default_rng(0))


class Backend(Apart):
    """Says what a bridge says at its start, and at a reset goal and truth of the first tick; the goal comes to `episode` later."""

    def __init__(self, domain_id):
        super().__init__("sim_bridge", domain_id)
        self._goal = self.node.create_publisher(PoseStamped, "goal_pose", qos.LATCHED)
        self._late = self.node.create_publisher(PoseStamped, "late", qos.LATCHED)
        self._keypoints = self.node.create_publisher(PointCloud2, "keypoints", qos.LOCKSTEP)
        self._truth = self.node.create_publisher(PoseStamped, "object_pose", qos.LOCKSTEP)
        self.node.create_service(Trigger, "~/reset", self._reset)
        for publisher in (self._goal, self._late):
            publisher.publish(_message(0, GOAL))
        self.begin()

    def see(self, stamp):
        """Keypoints and truth of an image."""
        self._keypoints.publish(keypoints_message(stamp, CAMERA_NAME, project_keypoints(CARD, START)))
        self._truth.publish(_message(stamp, START))

    def push(self, steps):
        """The object is led to its goal in so many poses, which are there when this returns."""
        for share in np.linspace(0, 1, steps):
            position = (1 - share) * START.position + share * GOAL.position
            self._truth.publish(_message(2 * TICK + round(share * TICK), Pose(position, GOAL.quaternion)))
        assert self._truth.wait_for_all_acked(Duration(seconds=TIMEOUT))

    def _reset(self, _request, response):
        self._goal.publish(_message(TICK, GOAL))
        self._truth.publish(_message(TICK, START))
        timer = self.node.create_timer(0.5, lambda: (timer.cancel(), self._late.publish(_message(TICK, GOAL))))
        response.success = True
        return response


def _message(stamp, pose):
    return pose_message(stamp, BASE_FRAME, pose.position, pose.quaternion)


@pytest.fixture
def backend(graph):
    backend = Backend(graph.domain_id)
    yield backend
    backend.close()


def test_an_episode_is_started_when_its_goal_is_in_force_and_scored_by_the_last_of_the_truth(graph, probe, backend):
    """It came to the conductor before `episode` had it, whose start would have been with the goal of before."""
    graph.run("np_policy", "episode", remappings=[("goal_pose", "late")])
    probe.wait_until_ready({"episode"})
    backend.see(0)

    def at_its_end(state, _):
        if state.phase == "failed":
            backend.push(1000)

    with EpisodeRunner(graph, CARD, on_phase=at_its_end) as conductor:
        conductor.wait_until_ready([], services=("sim_bridge/reset", "episode/start"))
        outcome = conductor.run_episode(until=time.monotonic() + 1.0)
    assert (outcome.declared, outcome.reason) == ("failed", "pre: stopped on request")
    assert outcome.success and outcome.distance < 1e-6 and outcome.duration == pytest.approx(0.2)


def test_no_phase_is_missed_by_a_conductor_that_is_slow(graph, probe):
    heard = []
    with EpisodeRunner(graph, CARD, on_phase=lambda state, _: heard.append(state)) as conductor:
        phases = probe.advertise("episode/phase", DiagnosticArray, qos.LATCHED)
        probe.wait_until(lambda: probe.matched("episode/phase"))
        said = [PhaseState("pre"), PhaseState("approach"), PhaseState("post"), PhaseState("pre", "contact 2: timeout")]
        for state in said:
            phases.publish(phase_message(state))
            assert phases.wait_for_all_acked(Duration(seconds=TIMEOUT))
        for _ in range(50):  # all have come; so long is nobody held up that none of them is taken
            if len(heard) < len(said):
                conductor.listen(0.1)
    assert heard == said
