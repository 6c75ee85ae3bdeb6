"""When an episode chooses a contact: with an object at rest, and again after one whose time is over."""

from dataclasses import replace

import numpy as np
import pytest
from episode_tools import START, TICK, in_post, in_pre, keypoints, phases, ticks

from np_common.rotations import matrix_from_vector, quaternion_from_matrix
from np_description.phases import PhaseState
from np_policy.episode import InputRefusal

LEANING = replace(
    START,
    position=START.position + [0, 0, 0.03],
    quaternion=quaternion_from_matrix(matrix_from_vector(np.array([0.6, 0, 0]))),
)


def test_an_object_that_rests_nowhere_is_refused_before_the_arm_moves():
    episode = in_pre()
    (event,) = episode.keypoints(TICK, keypoints(LEANING))  # and no tick, in which a plan would begin
    assert str(event).startswith("failed: pre: expected the object at rest on a face, got one tilted by 34 degrees")
    with pytest.raises(InputRefusal):
        episode.trajectory(TICK, 0.2)


def test_an_object_that_the_hand_has_set_against_something_may_be_touched_again():
    episode = in_post(post_timeout=0.5, contacts=2)
    for i in range(7, 15):
        events = episode.keypoints(i * TICK, keypoints(LEANING))
    assert events == [] and (episode.phase, episode.awaits) == ("pre", "joint_trajectory")


def test_when_the_time_of_a_contact_is_over_another_is_chosen_after_a_rest_from_what_is_seen_then():
    episode = in_post(post_timeout=0.5, contacts=2)
    for i in range(7, 11):
        episode.keypoints(i * TICK, keypoints())
    events = episode.keypoints(11 * TICK, keypoints())
    assert events[0] == PhaseState("pre", "contact 2: timeout", since=str(14 * TICK)) and ticks(events) == [(11, "pre")]
    for i in (12, 13):  # the hand lets go, the object comes to rest
        assert ticks(episode.keypoints(i * TICK, keypoints())) == [(i, "pre")]
    assert episode.keypoints(14 * TICK, keypoints()) == [] and episode.awaits == "joint_trajectory"
    with pytest.raises(InputRefusal):  # the first contact's plan
        episode.trajectory(TICK, 0.2)
    assert ticks(episode.trajectory(14 * TICK, 0.2)) == [(14, "approach")]
    for i in range(15, 20):
        episode.keypoints(i * TICK, keypoints())
    assert episode.phase == "post"  # with a time of its own
    for i in range(20, 24):
        assert ticks(episode.keypoints(i * TICK, keypoints())) == [(i, "post")]
    assert phases(episode.keypoints(24 * TICK, keypoints())) == ["failed: post: timeout"]


def test_an_object_that_is_not_seen_is_looked_for_with_another_contact_while_there_is_one():
    episode = in_post(post_blind=0.3, contacts=2)
    for i in range(7, 10):
        assert ticks(episode.keypoints(i * TICK, None)) == [(i, "post")]
    events = episode.keypoints(10 * TICK, None)
    reason = "contact 2: keypoints: fewer than 6 usable keypoints for 0.3 s"
    assert events[0] == PhaseState("pre", reason, since=str(13 * TICK)) and ticks(events) == [(10, "pre")]
    for i in range(11, 15):  # still hidden
        assert ticks(episode.keypoints(i * TICK, None)) == [(i, "pre")]
    assert episode.keypoints(15 * TICK, keypoints()) == [] and episode.awaits == "joint_trajectory"
    episode.trajectory(15 * TICK, 0.2)
    for i in range(16, 21):
        episode.keypoints(i * TICK, keypoints())
    assert episode.phase == "post"
    for i in range(21, 24):
        episode.keypoints(i * TICK, None)
    assert phases(episode.keypoints(24 * TICK, None)) == [f"failed: post: {reason.partition(': ')[2]}"]


def test_in_real_time_a_plan_for_what_was_seen_before_the_rest_is_refused():
    episode = in_pre(lockstep=False, post_timeout=0.5, contacts=2)
    episode.keypoints(TICK, keypoints())
    episode.trajectory(TICK, 0.2)
    for i in range(2, 12):
        episode.keypoints(i * TICK, keypoints())
    assert episode.phase == "pre" and episode.awaits == "keypoints"
    for i in range(12, 16):
        assert ticks(episode.keypoints(i * TICK, keypoints())) == [(i, "pre")]
    for early in (TICK, 13 * TICK):
        with pytest.raises(InputRefusal):
            episode.trajectory(early, 0.2)
    assert phases(episode.trajectory(14 * TICK, 0.2)) == ["approach"]
