"""The phase machine: every way through an episode and every way out of it, without ROS."""

from dataclasses import replace

import numpy as np
import pytest
from behind_the_hand import CORNERS_OFF
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from np_common.rotations import matrix_from_vector, quaternion_from_matrix, quaternion_multiply, yaw_quaternion
from np_description.camera import CAMERA
from np_description.domains import BUMP, CARD, WALL, Pose, sample_task
from np_description.phases import PhaseState
from np_perception.pose_estimation import project_keypoints
from np_policy.episode import ACTIVE, FAILED, IDLE, Episode, EpisodeConfig, Goal, InputRefusal, Tick

TICK = 100_000_000
START, GOAL = sample_task(CARD, np.random.default_rng(0))


def keypoints(pose=START, score=1.0):
    points = project_keypoints(CARD, pose)
    points[:, 2] = score
    return points


BLIND = keypoints(score=0.0)


def make(**options):
    return Episode(EpisodeConfig(CARD, **options))


def phases(events):
    return [str(event) for event in events if isinstance(event, PhaseState)]


def ticks(events):
    return [(event.stamp // TICK, event.phase) for event in events if isinstance(event, Tick)]


def in_approach(duration=0.2, **options):
    """An episode whose trajectory starts at tick 1 and, with settling, ends after duration + 0.3 s."""
    episode = make(**options)
    episode.goal(TICK, GOAL)
    episode.start()
    episode.keypoints(TICK, keypoints())
    episode.trajectory(TICK, duration)
    return episode


def in_post(**options):
    """An episode in phase post since tick 6."""
    episode = in_approach(**options)
    for i in range(2, 7):
        episode.keypoints(i * TICK, keypoints())
    assert episode.phase == "post"
    return episode


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


def test_success_must_be_in_a_row():
    episode = in_post(success_frames=2)
    for i, pose in enumerate([GOAL, START, GOAL, START, GOAL], 7):
        episode.keypoints(i * TICK, keypoints(pose))
        assert episode.phase == "post"
    assert phases(episode.keypoints(12 * TICK, keypoints(GOAL))) == ["succeeded"]


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
    episode = make()
    episode.goal(TICK, GOAL)
    episode.start()
    for i in range(1, 21):
        assert ticks(episode.keypoints(i * TICK, None if i % 2 else BLIND)) == [(i, "pre")]
    assert phases(episode.keypoints(21 * TICK, BLIND)) == ["failed: pre: fewer than 6 usable keypoints for 2 s"]


LEANING = replace(
    START,
    position=START.position + [0, 0, 0.03],
    quaternion=quaternion_from_matrix(matrix_from_vector(np.array([0.6, 0, 0]))),
)


def test_an_object_that_rests_nowhere_is_refused_before_the_arm_moves():
    episode = make()
    episode.goal(TICK, GOAL)
    episode.start()
    (event,) = episode.keypoints(TICK, keypoints(LEANING))  # and no tick, in which a plan would begin
    assert str(event).startswith("failed: pre: expected the object at rest on a face, got one tilted by 34 degrees")
    with pytest.raises(InputRefusal):
        episode.trajectory(TICK, 0.2)


def test_an_object_that_the_hand_has_set_against_something_may_be_touched_again():
    episode = in_post(post_timeout=0.5, contacts=2)
    for i in range(7, 15):
        events = episode.keypoints(i * TICK, keypoints(LEANING))
    assert events == [] and (episode.phase, episode.awaits) == ("pre", "joint_trajectory")


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
    episode = make(lockstep=False, post_timeout=0.5, contacts=2)
    episode.goal(TICK, GOAL)
    episode.start()
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


def test_the_edge_of_the_tolerance_is_success_only_when_the_time_is_over():
    edge = Pose(GOAL.position + [0.0, 0.9 * CARD.tolerance_position, 0.0], GOAL.quaternion)
    episode = in_post(post_timeout=0.5, success_frames=3, success_share=0.8)
    for i in range(7, 11):
        assert ticks(episode.keypoints(i * TICK, keypoints(edge)))
    assert phases(episode.keypoints(11 * TICK, keypoints(edge))) == ["succeeded"]
    late = in_post(post_timeout=0.5, success_frames=3, success_share=0.8)
    for i in range(7, 11):
        assert ticks(late.keypoints(i * TICK, keypoints(edge if i > 9 else START)))
    assert phases(late.keypoints(11 * TICK, keypoints(edge))) == ["failed: post: timeout"]


def moved(shift):
    """CAMERA moved and turned by shift (6,) m and rad in base axes."""
    rotation = matrix_from_vector(shift[3:]) @ np.asarray(CAMERA.rotation)
    return replace(CAMERA, position=tuple(CAMERA.position + shift[:3]), rotation=tuple(map(tuple, rotation)))


def turned(off, way, yaw):
    """GOAL moved by off m along the table and turned by yaw rad."""
    turn = yaw_quaternion(np.asarray(yaw))
    return Pose(
        GOAL.position + off * np.array([np.cos(way), np.sin(way), 0]), quaternion_multiply(turn, GOAL.quaternion)
    )


def shown(pose, camera, covariance, noise=0.0, share=1.0, late=False):
    """The ended or judged episode to which an object at `pose` was shown by `camera`, believed to be CAMERA with `covariance`."""
    episode = in_post(post_timeout=0.5, success_frames=2, success_share=share, camera_covariance=covariance)
    rng = np.random.default_rng(0)
    for i in range(7, 12 if late else 10):
        points = project_keypoints(CARD, pose, camera)
        points[:, :2] += noise * rng.standard_normal((8, 2))
        episode.keypoints(i * TICK, points)
    return episode


def factor(spread):
    """A matrix (6, 6) whose product with its transpose is a camera's covariance: some mm and mrad, not along the axes."""
    return spread * (np.eye(6) + 0.5 * np.tri(6, k=-1))


@given(
    st.floats(0, 0.02),
    st.floats(-np.pi, np.pi),
    st.floats(0, 0.15),
    arrays(float, 6, elements=st.floats(-1, 1)),
    st.floats(1e-5, 2e-3),
)
@settings(max_examples=60, deadline=None)
def test_no_camera_within_its_bound_makes_a_success_of_an_object_outside_the_tolerance(off, way, yaw, drawn, spread):
    half = factor(spread)
    error = half @ (2 * drawn / max(1.0, np.linalg.norm(drawn)))
    episode = shown(turned(off, way, yaw), moved(error), half @ half.T, late=True)
    assert episode.phase in ("succeeded", FAILED)
    if episode.phase == "succeeded":
        assert off < CARD.tolerance_position + 2e-4 and yaw < CARD.tolerance_angle + 2e-3


@given(st.floats(0, 0.02), st.floats(-np.pi, np.pi), st.floats(0, 0.15), st.floats(0.2, 2.5))
@settings(max_examples=40, deadline=None)
def test_no_noise_makes_a_success_of_an_object_further_off_than_the_bound(off, way, yaw, noise):
    episode = shown(turned(off, way, yaw), CAMERA, None, noise)
    if episode.phase == "succeeded":
        assert off <= CARD.tolerance_position + episode.position_bound
        assert yaw <= CARD.tolerance_angle + episode.angle_bound


@given(
    st.floats(0, 0.01),
    st.floats(-np.pi, np.pi),
    st.floats(0, 0.1),
    st.floats(1e-5, 3e-3),
    st.floats(1, 3),
    st.booleans(),
)
@settings(max_examples=40, deadline=None)
def test_what_is_declared_is_also_declared_with_less_uncertainty(off, way, yaw, spread, more, late):
    half = factor(spread)
    sure, unsure = (
        shown(turned(off, way, yaw), CAMERA, times**2 * half @ half.T, 0.3, share=0.8, late=late) for times in (1, more)
    )
    assert sure.position_bound <= unsure.position_bound and sure.angle_bound <= unsure.angle_bound
    assert sure.phase == "succeeded" or unsure.phase != "succeeded"


def test_an_uncertainty_that_is_no_number_is_no_success():
    assert shown(GOAL, CAMERA, None).phase == "succeeded"
    assert shown(GOAL, CAMERA, np.full((6, 6), np.nan), late=True).phase == FAILED


def test_an_estimate_at_the_goal_that_is_too_uncertain_says_so_when_the_time_is_over():
    episode = in_post(post_timeout=0.5, success_frames=2, camera_covariance=np.diag([0.005**2] * 3 + [0.0] * 3))
    for i in range(7, 11):
        assert ticks(episode.keypoints(i * TICK, keypoints(GOAL)))
    (end,) = episode.keypoints(11 * TICK, keypoints(GOAL))
    said = "post: timeout: at the goal by an estimate that is too uncertain: "
    assert end.phase == FAILED and end.reason.startswith(said)
    assert (
        float(end.position_bound) == pytest.approx(episode.position_bound, abs=1e-4) and episode.position_bound > 0.01
    )


def test_the_end_says_the_bounds_of_its_own_estimate_only():
    episode = in_post(success_frames=1, camera_covariance=np.diag([0.001**2] * 3 + [0.0] * 3))
    (end,) = episode.keypoints(7 * TICK, keypoints(GOAL))
    assert end.phase == "succeeded" and 0.002 < float(end.position_bound) < 0.006
    episode.start()
    (end,) = episode.stop()
    assert (end.phase, end.position_bound, end.angle_bound) == (FAILED, "", "")


def test_what_is_only_slid_lies_though_hidden_corners_make_it_look_tilted():
    episode = in_post(success_frames=3)
    points = keypoints(GOAL)
    points[:, :2] += CORNERS_OFF
    for i in (7, 8):
        assert ticks(episode.keypoints(i * TICK, points))
    assert episode.angle < 0.03
    assert phases(episode.keypoints(9 * TICK, points)) == ["succeeded"]


def test_what_may_be_tumbled_is_taken_as_it_looks():
    assert [domain.is_tumbled for domain in (CARD, BUMP, WALL)] == [False, True, True]


def test_a_lost_object_ends_post():
    episode = in_post(success_frames=2)
    gone = Pose(np.array([0.3, 0.0, 0.0025]), START.quaternion)
    episode.keypoints(7 * TICK, keypoints(gone))
    assert phases(episode.keypoints(8 * TICK, keypoints(gone))) == ["failed: post: the object left the workspace"]


def test_a_failed_plan_fails_the_approach_with_its_reason():
    episode = make()
    episode.goal(TICK, GOAL)
    episode.start()
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
    episode = make()
    episode.goal(TICK, GOAL)
    episode.start()
    episode.keypoints(TICK, keypoints())
    assert episode.overdue(59.0) == []
    assert phases(episode.overdue(61.0)) == ["failed: approach: no joint_trajectory within 60 s"]


def test_a_fault_ends_the_episode_and_forbids_the_next():
    episode = in_post()
    assert phases(episode.backend("stopped: joint 3")) == ["fault: stopped: joint 3"]
    assert episode.backend("stopped: joint 3") == []
    with pytest.raises(InputRefusal, match="stopped: joint 3"):
        episode.start()
    assert phases(episode.backend("")) == ["idle"]
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
    episode = make(lockstep=False)
    episode.goal(TICK, GOAL)
    episode.start()
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
    episode = make(lockstep=False)
    episode.goal(TICK, GOAL)
    episode.start()
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
