"""The phase machine: every way through an episode and every way out of it, without ROS."""

import numpy as np
import pytest
from episode_tools import BLIND, GOAL, START, TICK, in_approach, in_post, in_pre, keypoints, make, phases, ticks
from hypothesis import given, settings
from hypothesis import strategies as st

from np_description.domains import CARD, Pose
from np_description.phases import PhaseState
from np_perception.pose_estimation import project_keypoints
from np_policy.episode import ACTIVE, FAILED, IDLE, Episode, Goal, InputRefusal, Tick
from np_policy.episode_config import EpisodeConfig


def test_no_episode_begins_with_the_goal_before_one_that_was_refused():
    episode = make()
    episode.goal(TICK, GOAL)
    episode.refuse_goal("x 3.8 m")
    with pytest.raises(InputRefusal, match="newest goal was refused, give another one: x 3.8 m"):
        episode.start()
    episode.goal(TICK, GOAL)  # the same again is a newer one
    assert phases(episode.start()) == ["pre"]


def test_keypoints_of_a_backend_that_was_restarted_count_though_its_first_goal_was_refused():
    episode = in_post()  # keypoints of tick 6 were the newest
    episode.refuse_goal("not finite")
    episode.goal(2 * TICK, GOAL)
    episode.start()
    episode.keypoints(2 * TICK, keypoints())
    assert episode.awaits == "joint_trajectory"


def test_an_episode_from_start_to_success():
    episode = make(success_frames=3)
    (goal,) = episode.goal(TICK, GOAL)
    assert isinstance(goal, Goal) and goal.stamp == TICK
    np.testing.assert_array_equal(goal.keypoints, project_keypoints(CARD, GOAL))
    assert phases(episode.start()) == ["pre"]
    assert episode.keypoints(TICK, keypoints()) == []  # time stands still while the planner thinks
    assert episode.awaits == "joint_trajectory"
    events = episode.trajectory(TICK, 0.2)
    assert phases(events) == ["approach"] and ticks(events) == [(1, "approach")]
    for i in range(2, 6):
        assert ticks(episode.keypoints(i * TICK, keypoints())) == [(i, "approach")]
    events = episode.keypoints(6 * TICK, keypoints())  # 0.2 s of motion and 0.3 s of rest after tick 1
    assert phases(events) == ["post"] and ticks(events) == [(6, "post")]
    assert ticks(episode.keypoints(7 * TICK, keypoints(GOAL))) == [(7, "post")]
    assert ticks(episode.keypoints(8 * TICK, keypoints(GOAL))) == [(8, "post")]
    assert [str(e) for e in episode.keypoints(9 * TICK, keypoints(GOAL))] == ["succeeded"]  # and no tick
    assert episode.distance < 1e-4 and episode.keypoints(10 * TICK, keypoints(GOAL)) == []


def test_keypoints_before_the_reset_are_not_used():
    episode = make()
    episode.keypoints(4 * TICK, keypoints())
    episode.start()
    assert episode.awaits == "goal_pose"
    episode.goal(5 * TICK, GOAL)
    assert episode.awaits == "keypoints"
    assert episode.keypoints(5 * TICK, keypoints()) == [] and episode.awaits == "joint_trajectory"


def test_keypoints_that_came_before_the_start_are_used():
    episode = make()
    episode.goal(TICK, GOAL)
    episode.keypoints(TICK, keypoints())
    episode.start()
    assert episode.awaits == "joint_trajectory"


def test_lockstep_decides_on_policy_ticks_only():
    episode = in_approach()
    assert episode.keypoints(TICK + 34_000_000, keypoints()) == []
    assert ticks(episode.keypoints(2 * TICK, keypoints())) == [(2, "approach")]
    assert episode.keypoints(TICK, keypoints()) == []


def test_in_lockstep_a_question_asked_twice_is_answered_twice():
    episode = in_approach()
    assert episode.trajectory(TICK, 0.2) == []
    # The first tick of the approach too: a controller that was started a moment ago may not have heard it.
    assert ticks(episode.keypoints(TICK, keypoints())) == [(1, "approach")]
    first = episode.keypoints(2 * TICK, keypoints())
    assert episode.keypoints(2 * TICK, keypoints()) == first
    episode.stop()
    assert episode.keypoints(2 * TICK, keypoints()) == []


def test_unusable_keypoints_let_time_pass_and_end_pre_after_two_seconds():
    episode = in_pre()
    for i in range(1, 21):
        assert ticks(episode.keypoints(i * TICK, None if i % 2 else BLIND)) == [(i, "pre")]
    assert phases(episode.keypoints(21 * TICK, BLIND)) == ["failed: pre: fewer than 6 usable keypoints for 2 s"]


def test_unusable_keypoints_end_post_after_a_second():
    episode = in_post()
    for i in range(7, 17):
        assert ticks(episode.keypoints(i * TICK, BLIND))
    (reason,) = phases(episode.keypoints(17 * TICK, None))
    assert reason.startswith("failed: post: keypoints")


def test_post_ends_with_its_timeout():
    episode = in_post(post_timeout=0.5)
    for i in range(7, 11):
        assert ticks(episode.keypoints(i * TICK, keypoints()))
    assert phases(episode.keypoints(11 * TICK, keypoints())) == ["failed: post: timeout"]


def test_a_lost_object_ends_post():
    episode = in_post(success_frames=2)
    gone = Pose(np.array([0.3, 0.0, 0.0025]), START.quaternion)
    episode.keypoints(7 * TICK, keypoints(gone))
    assert phases(episode.keypoints(8 * TICK, keypoints(gone))) == ["failed: post: the object left the workspace"]


def test_a_failed_plan_fails_the_approach_with_its_reason():
    episode = in_pre()
    episode.keypoints(TICK, keypoints())
    assert phases(episode.refusal(TICK, "unreachable: far away")) == ["failed: approach: unreachable: far away"]


def test_a_plan_for_another_image_is_refused():
    episode = make()
    episode.goal(TICK, GOAL)
    with pytest.raises(InputRefusal):
        episode.trajectory(TICK, 1.0)
    episode.start()
    episode.keypoints(TICK, keypoints())
    with pytest.raises(InputRefusal, match="a plan for 200000000 ns"):
        episode.trajectory(2 * TICK, 1.0)
    assert episode.phase == "pre"


@pytest.mark.parametrize(
    "prepare, topic", [(lambda: make(), "goal_pose"), (in_approach, "keypoints"), (in_post, "keypoints")]
)
def test_silence_is_named(prepare, topic):
    episode = prepare()
    if not episode.is_active:
        episode.start()
    assert episode.overdue(29.0) == []
    assert phases(episode.overdue(31.0)) == [
        f"failed: {'pre' if topic == 'goal_pose' else episode_phase(prepare)}: no {topic} within 30 s"
    ]


def episode_phase(prepare):
    return prepare().phase


def test_a_silent_planner_is_named():
    episode = in_pre()
    episode.keypoints(TICK, keypoints())
    assert episode.overdue(59.0) == []
    assert phases(episode.overdue(61.0)) == ["failed: approach: no joint_trajectory within 60 s"]


def test_a_fault_ends_the_episode_and_forbids_the_next():
    episode = in_post()
    assert phases(episode.backend("stopped: joint 3")) == ["fault: stopped: joint 3"]
    assert episode.backend("stopped: joint 3") == []
    with pytest.raises(InputRefusal, match="stopped: joint 3"):
        episode.start()
    assert phases(episode.backend("")) == ["idle"] and episode.phase == IDLE
    assert episode.backend("") == []
    assert phases(episode.start()) == ["pre"]


def ended(episode):
    """The episode, stopped."""
    episode.stop()
    return episode


@pytest.mark.parametrize("reach", [make, in_post, lambda: ended(in_post())])
def test_a_fault_is_told_in_every_phase_for_the_controller_goes_by_it(reach):
    episode = reach()
    assert phases(episode.backend("stopped: joint 3")) == ["fault: stopped: joint 3"]
    assert phases(episode.backend("")) == ["idle"]


def test_start_and_stop_are_refused_where_they_make_no_sense():
    episode = make()
    with pytest.raises(InputRefusal, match="no episode is under way"):
        episode.stop()
    episode.start()
    with pytest.raises(InputRefusal, match="under way, in phase pre"):
        episode.start()
    assert phases(episode.stop()) == ["failed: pre: stopped on request"]


def test_a_reset_ends_the_episode_and_the_next_needs_a_new_goal_in_lockstep():
    episode = in_post()
    events = episode.goal(9 * TICK, START)
    assert phases(events) == ["failed: post: the task was reset"] and isinstance(events[1], Goal)
    episode.start()
    episode.keypoints(9 * TICK, keypoints())
    assert episode.awaits == "joint_trajectory"
    episode.stop()
    episode.start()
    episode.keypoints(10 * TICK, keypoints())
    assert episode.awaits == "goal_pose"


@pytest.mark.parametrize("stamp", [TICK, 5 * TICK])
def test_a_goal_that_was_in_force_before_the_present_one_is_refused(stamp):
    """Latched, of a backend that is found after whoever gave the newer goal."""
    episode = make(lockstep=False)
    episode.goal(5 * TICK, GOAL, sent=200)
    episode.start()
    episode.keypoints(6 * TICK, keypoints())
    with pytest.raises(InputRefusal, match="sent before the one of 500000000 ns"):
        episode.goal(stamp, START, sent=100)
    assert episode.phase == "pre"
    # A backend that was restarted, or a computer whose clock is behind: not late.
    for later, sent in ((TICK, 300), (2 * TICK, 50)):
        assert [event.stamp for event in episode.goal(later, START, sent) if isinstance(event, Goal)] == [later]


def test_in_real_time_the_same_goal_may_be_tried_again():
    episode = in_pre(lockstep=False)
    assert ticks(episode.keypoints(TICK + 7, keypoints()))
    episode.stop()
    episode.keypoints(9 * TICK, keypoints())
    assert phases(episode.start()) == ["pre"] and episode.awaits == "keypoints"
    assert ticks(episode.keypoints(10 * TICK, keypoints())) == [(10, "pre")]
    assert episode.awaits == "joint_trajectory"


@pytest.mark.parametrize("is_used", [False, True])
def test_in_real_time_an_episode_begins_with_an_image_of_after_its_start(is_used):
    """However long the camera has been silent."""
    episode = make(lockstep=False)
    episode.goal(TICK, GOAL)
    if is_used:
        episode.start()
        episode.keypoints(TICK, keypoints())
        episode.stop()
    episode.keypoints(2 * TICK, keypoints())
    assert not ticks(episode.start())
    assert episode.awaits == "keypoints"
    with pytest.raises(InputRefusal):  # for the old image
        episode.trajectory(2 * TICK, 1.0)
    assert phases(episode.overdue(31.0)) == ["failed: pre: no keypoints within 30 s"]


@pytest.mark.parametrize(
    "off, phase",
    [(0.05, "post"), (0.2, "failed: approach: the arm did not arrive: joint 3 is 0.20 rad from the plan's end")],
)
def test_post_begins_only_where_the_plan_ends(off, phase):
    end = np.linspace(-1, 1, 7)
    episode = Episode(EpisodeConfig(CARD, lockstep=False), lambda: end + off * (np.arange(7) == 2))
    episode.goal(TICK, GOAL)
    episode.start()
    episode.keypoints(TICK, keypoints())
    episode.trajectory(TICK, 0.2, end=end)
    assert phases(episode.keypoints(7 * TICK, keypoints())) == [phase]


def test_a_backend_that_says_nothing_more_ends_the_episode_once():
    episode = in_post()
    assert phases(episode.backend_lost("no diagnostics")) == ["failed: post: no diagnostics"]
    assert episode.backend_lost("no diagnostics") == []


def test_in_real_time_ticks_go_on_while_the_planner_thinks_and_the_motion_begins_on_receipt():
    episode = in_pre(lockstep=False)
    assert ticks(episode.keypoints(TICK, keypoints())) == [(1, "pre")]
    assert episode.keypoints(TICK + 33_000_000, keypoints()) == []
    for i in range(2, 12):
        assert ticks(episode.keypoints(i * TICK, keypoints())) == [(i, "pre")]
    assert phases(episode.trajectory(TICK, 0.2)) == ["approach"]
    for i in range(12, 16):
        assert ticks(episode.keypoints(i * TICK, keypoints())) == [(i, "approach")]
    assert phases(episode.keypoints(16 * TICK, keypoints())) == ["post"]


@given(st.data())
@settings(max_examples=60)
def test_whatever_comes_ticks_increase_and_belong_to_an_episode(data):
    """Any order of inputs: no exception but Refused, ticks only while active and never backwards."""
    episode = make(
        lockstep=data.draw(st.booleans()),
        success_frames=2,
        post_timeout=0.5,
        pre_timeout=0.3,
        contacts=data.draw(st.integers(1, 3)),
    )
    last, stamp = -1, 0
    for _ in range(data.draw(st.integers(1, 40))):
        stamp += data.draw(st.sampled_from([0, TICK // 3, TICK]))
        if data.draw(st.booleans()):
            stamp -= stamp % TICK
        stamp = max(stamp, last)
        what = data.draw(
            st.sampled_from(
                ["keypoints"] * 6 + ["start", "start", "stop", "goal", "plan", "plan", "refusal", "fault", "late"]
            )
        )
        try:
            events = {
                "keypoints": lambda: episode.keypoints(
                    stamp, data.draw(st.sampled_from([None, BLIND, keypoints(GOAL)]))
                ),
                "start": episode.start,
                "stop": episode.stop,
                "goal": lambda: episode.goal(stamp, GOAL),
                "plan": lambda: episode.trajectory(data.draw(st.sampled_from([stamp, last])), 0.1),
                "refusal": lambda: episode.refusal(data.draw(st.sampled_from([stamp, last]))),
                "fault": lambda: episode.backend(data.draw(st.sampled_from(["", "held"]))),
                "late": lambda: episode.overdue(100.0),
            }[what]()
        except InputRefusal:
            continue
        for event in events:
            if isinstance(event, Tick):
                assert event.stamp >= last and event.phase in ACTIVE
                last = event.stamp
        ends = [event for event in events if isinstance(event, PhaseState) and event.phase not in ACTIVE]
        assert all(event.phase in ("succeeded", IDLE) or event.reason for event in ends)
        if ends and ends[-1] is events[-1]:
            assert not episode.is_active
    assert episode.phase in (*ACTIVE, IDLE, FAILED, "succeeded", "fault")
