"""Backends and planners that know `tick`, `phase` and empty trajectories as they were before the phase had keys."""

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header, String
from trajectory_msgs.msg import JointTrajectory

from np_description.domains import CARD, sample_task
from np_description.message_arrays import stamp_nanoseconds
from np_description.panda import BASE_FRAME, JOINT_NAMES
from np_description.scene import CAMERA_NAME
from np_perception.pose_estimation import project_keypoints
from np_ros import qos
from np_ros.messages import keypoints_message, pose_message, trajectory_message

TICK = 100_000_000
START, GOAL = sample_task(CARD, np.random.default_rng(0))


class FormerBackend:
    """Takes a policy period when `tick` has said the present one; sees the object from `seen` ns on."""

    def __init__(self, graph, probe, seen=0, **parameters):
        self._probe, self._seen, self.stamp = probe, seen, 0
        self.ticks = probe.collect("tick", Header, callback=self._go_on)
        self.phases = probe.collect("phase", String, qos.LATCHED)
        probe.advertise("goal_pose", PoseStamped, qos.LATCHED)
        probe.advertise("keypoints", PointCloud2)
        probe.advertise("joint_trajectory", JointTrajectory, qos.EVENT)
        probe.wait_until_ready({graph.run("np_policy", "episode", {"mode": "lockstep", **parameters})})

    def start(self):
        goal = pose_message(0, BASE_FRAME, GOAL.position, GOAL.quaternion)
        self._probe.publish("goal_pose", goal, qos.LATCHED)
        self._show()
        assert self._probe.call("episode/start").success

    def plan_until(self, phase, rows):
        """Answer the first good image with these rows (n, 7) until `phase` begins with this."""
        rows = np.reshape(rows, (-1, 7))
        times = np.arange(1, 1 + len(rows)) * 0.05
        message = trajectory_message(self._seen, JOINT_NAMES, times, rows, np.zeros_like(rows))

        def has_begun():
            self._probe.publish("joint_trajectory", message, qos.EVENT)  # refused before the image is there
            return self.phases[-1].data.startswith(phase)

        self.wait(has_begun, f"phase {phase}")

    def wait(self, condition, what):
        self._probe.wait_until(condition, what=f"{what} after {[message.data for message in self.phases]}")

    def _go_on(self, tick):
        if stamp_nanoseconds(tick.stamp) == self.stamp:
            self.stamp += TICK
            self._show()

    def _show(self):
        points = project_keypoints(CARD, START)
        points[:, 2] = float(self.stamp >= self._seen)
        self._probe.publish("keypoints", keypoints_message(self.stamp, CAMERA_NAME, points))


def test_a_backend_that_knows_only_the_former_topics_goes_through_an_episode(graph, probe):
    backend = FormerBackend(graph, probe, seen=3 * TICK, settle=0.0, post_timeout=3600.0)
    backend.start()
    backend.wait(lambda: backend.stamp == 3 * TICK, "the ticks of phase pre")
    backend.plan_until("post", np.zeros((2, 7)))
    assert probe.call("episode/stop").success
    backend.wait(lambda: backend.phases[-1].data.startswith("failed"), "the end")
    said = [message.data for message in backend.phases]
    whole = ["idle", "pre", "approach", "post", "failed: post: stopped on request"]
    # A latched topic keeps one message: who is slow may miss one that another follows at once, and never the last.
    assert said == [phase for phase in whole if phase in said] and {"pre", whole[-1]} <= set(said)
    ticks = [(stamp_nanoseconds(tick.stamp) // TICK, tick.frame_id) for tick in backend.ticks]
    assert ticks[:5] == [(0, "pre"), (1, "pre"), (2, "pre"), (3, "approach"), (4, "post")]
    assert [number for number, _ in ticks] == list(range(len(ticks)))


def test_a_planner_that_knows_only_empty_trajectories_fails_the_approach(graph, probe):
    backend = FormerBackend(graph, probe)
    backend.start()
    backend.plan_until("failed", [])
    assert backend.phases[-1].data == "failed: approach: no plan"
