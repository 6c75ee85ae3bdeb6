"""Episodes without a graph: what the nodes call, in one process."""

from functools import partial

import numpy as np
import pytest
from sim2real.effects.patch import Patch, PatchEffect

from np_description.domains import WALL, Pose
from np_evaluation.in_process import InProcessRollout, KeypointProjector
from np_planning.rrt import PlanningError
from np_policy.action import PolicyError
from np_policy.episode_config import EpisodeConfig
from np_sim_bridge.simulation import Simulation

LATE = Patch((PatchEffect("camera_latency", "camera", {"delay": 0.3}),))


@pytest.fixture(scope="module")
def first():
    """An episode as it should be."""
    return InProcessRollout(WALL, "mujoco", seed=3).play(0)


def test_an_episode_succeeds_and_is_the_same_again(first):
    again = InProcessRollout(WALL, "mujoco", seed=3).play(0)
    assert first.success and first.declared == "succeeded" and first.contacts == 1 and 3 < first.duration < 20
    assert (first.distance, first.angle, first.duration) == (again.distance, again.angle, again.duration)


@pytest.mark.slow
def test_a_patch_changes_an_episode(first, monkeypatch):
    weak = Patch((PatchEffect("gripper_friction", "contact", {"relative": -0.85}),))
    short = partial(EpisodeConfig, post_timeout=2 * first.duration)
    monkeypatch.setattr("np_evaluation.in_process.EpisodeConfig", short)
    weaker = InProcessRollout(WALL, "mujoco", seed=3, patch=weak).play(0)
    assert first.success and not weaker.success and weaker.reason == "post: timeout"


def test_a_plan_that_is_refused_ends_the_episode_in_words(monkeypatch):
    played = InProcessRollout(WALL, "mujoco")

    def refuse(*arguments, **options):
        raise PlanningError("no path found")

    monkeypatch.setattr("np_evaluation.in_process.plan_approach", refuse)
    refused = played.play(0)
    assert (refused.success, refused.failed_in, refused.reason) == (False, "approach", "approach: no path found")


def test_without_targets_the_arm_stays_until_the_time_is_over(monkeypatch):
    played = InProcessRollout(WALL, "mujoco")

    def refuse(*arguments):
        raise PolicyError("no action")

    monkeypatch.setattr(played._post, "act", refuse)
    monkeypatch.setattr("np_evaluation.in_process.EpisodeConfig", partial(EpisodeConfig, post_timeout=1.0))
    result = played.play(0)
    assert (result.success, result.failed_in, result.reason) == (False, "post", "post: timeout")


def test_an_object_that_was_thrown_behind_the_camera_is_not_seen(monkeypatch):
    arm, eyes = Simulation(WALL, seed=0), KeypointProjector(WALL, Patch(), 0)
    eyes.look(arm)
    assert eyes.seen(0)[:, 2].all()
    thrown = Pose(np.array([1.85, -0.3, 0.05]), np.array([1.0, 0.0, 0.0, 0.0]))
    monkeypatch.setattr(arm, "object_pose", lambda: thrown)
    eyes.look(arm)
    assert not eyes.seen(0)[:, 2].any()


class Slides:
    """An object at 0.1 m/s, of a robot that does nothing else."""

    stamp = 0

    def object_pose(self) -> Pose:
        return Pose(np.array([0.5, 1e-10 * self.stamp, 0.05]), np.array([1.0, 0.0, 0.0, 0.0]))


def test_eyes_that_are_late_see_what_was():
    def at(stamp, patch):
        arm, eyes = Slides(), KeypointProjector(WALL, patch, 0)
        for arm.stamp in range(0, stamp + 1, 2_000_000):
            eyes.look(arm)
        return eyes.seen(stamp)

    then, now, late = at(500_000_000, Patch()), at(800_000_000, Patch()), at(800_000_000, LATE)
    assert np.abs(now - then).max() > 3
    assert np.abs(late - then).max() < 0.05
