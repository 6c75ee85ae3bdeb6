"""Episodes without a graph: what the nodes call, in one process."""

import numpy as np
from one_process import OneProcess

from np_description.domains import WALL, Pose
from np_policy.action import PolicyError
from np_policy.planning import PlanningError
from np_sim_bridge.simulation import Simulation


def test_an_episode_succeeds_and_is_the_same_again():
    first, again = (OneProcess(WALL, "mujoco", seed=3).play(0) for _ in range(2))
    assert first.success and first.declared == "succeeded" and first.contacts == 1 and 3 < first.duration < 20
    assert (first.distance, first.angle, first.duration) == (again.distance, again.angle, again.duration)


def test_a_plan_that_is_refused_ends_the_episode_in_words(monkeypatch):
    played = OneProcess(WALL, "mujoco")

    def refuse(*arguments, **options):
        raise PlanningError("no path found")

    monkeypatch.setattr("one_process.plan_approach", refuse)
    refused = played.play(0)
    assert (refused.success, refused.failed_in, refused.reason) == (False, "approach", "approach: no path found")


def test_without_targets_the_arm_stays_until_the_time_is_over(monkeypatch):
    played = OneProcess(WALL, "mujoco")

    def refuse(*arguments):
        raise PolicyError("no action")

    monkeypatch.setattr(played._post, "act", refuse)
    result = played.play(0)
    assert (result.success, result.failed_in, result.reason) == (False, "post", "post: timeout")
    assert 20 < result.duration < 30


def test_an_object_that_was_thrown_behind_the_camera_is_not_seen(monkeypatch):
    arm, played = Simulation(WALL, seed=0), OneProcess(WALL, "mujoco")
    assert played._seen(arm)[:, 2].all()
    thrown = Pose(np.array([1.85, -0.3, 0.05]), np.array([1.0, 0.0, 0.0, 0.0]))
    monkeypatch.setattr(arm, "object_pose", lambda: thrown)
    assert not played._seen(arm)[:, 2].any()
