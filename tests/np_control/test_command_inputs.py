"""Which commands reach the controller: by phase, heartbeat and tick, in real time and in lockstep."""

from dataclasses import replace

import numpy as np
import pytest
from controller_tools import PERIOD, READY, SOFT, Arm, answers, quintic
from hypothesis import given, settings
from hypothesis import strategies as st

from np_control.controller import Controller
from np_control.kinematics import forward_kinematics
from np_control.lockstep_input import LockstepCommandInput
from np_control.realtime_input import RealtimeCommandInput
from np_control.safety import LIMITS, Reason, Refusal
from np_description.phases import PhaseState


@pytest.mark.parametrize("end", ["failed", "succeeded", "fault"])
def test_after_an_episode_nothing_is_followed_until_the_next(end):
    controller = Controller()
    following = RealtimeCommandInput(controller)
    answers(controller, 1)
    for phase in ("pre", "approach"):
        following.enter(phase)
    following.trajectory(quintic(READY + 0.3, 1.0), 0)
    moving = answers(controller, 200)[-1]
    following.enter(end)
    rest = answers(controller, 150, first=200)[-1]
    assert np.abs(rest.position - moving.position).max() < 0.1 and (rest.velocity == 0).all()
    with pytest.raises(Refusal, match=f"expected an episode under way.*phase is {end}"):
        following.trajectory(quintic(READY + 0.3, 1.0))
    following.gains(np.stack(SOFT))
    with pytest.raises(Refusal, match="expected an episode under way"):
        following.pose(0, forward_kinematics(READY))
    following.enter("pre")
    following.trajectory(quintic(READY + 0.3, 1.0))


def test_a_plan_that_comes_before_the_episode_has_taken_it_waits():
    following = RealtimeCommandInput(controller := Controller())
    answers(controller, 1)
    following.enter("pre")
    assert following.trajectory(None) is False and not following.has_plan  # no plan could be made
    assert not following.trajectory(quintic(READY + 0.3, 1.0)) and following.has_plan
    assert (answers(controller, 50, first=1)[-1].position == READY).all()
    assert following.enter("approach") and not following.has_plan
    assert (answers(controller, 50, first=51)[-1].position != READY).any()


@pytest.mark.parametrize("refuse", [lambda f: f.enter("failed"), lambda f: f.begin(), lambda f: f.forget()])
def test_a_plan_that_the_episode_does_not_take_is_not_followed(refuse):
    following = RealtimeCommandInput(controller := Controller())
    answers(controller, 1)
    following.enter("pre")
    following.trajectory(quintic(READY + 0.3, 1.0))
    refuse(following)
    assert not following.enter("pre") and not following.enter("approach")
    assert (answers(controller, 50, first=1)[-1].position == READY).all()


def test_an_arm_that_comes_back_in_the_middle_of_an_episode_is_not_moved():
    """A driver that was restarted: the policy goes on, but not for this arm."""
    following = RealtimeCommandInput(controller := Controller())
    answers(controller, 1)
    for phase in ("pre", "approach", "post"):
        following.enter(phase)
    following.begin()
    following.gains(np.stack(SOFT))
    with pytest.raises(Refusal, match="with the arm as it was"):
        following.pose(0, forward_kinematics(READY))
    following.enter("failed")
    following.enter("pre")
    following.gains(np.stack(SOFT))
    assert following.pose(0, forward_kinematics(READY)) is False


@pytest.mark.parametrize("is_heard_first", [True, False])
def test_a_driver_that_comes_in_the_middle_of_an_episode_follows_from_the_next_on(is_heard_first):
    """The phase is latched: it may be heard before the first state or after it."""
    following = RealtimeCommandInput(controller := Controller())
    answers(controller, 1)
    if is_heard_first:
        following.enter("post")
    following.begin()
    following.enter("post")
    with pytest.raises(Refusal, match="with the arm as it was"):
        following.trajectory(quintic(READY + 0.3, 1.0))
    following.enter("pre")
    following.enter("approach")
    following.trajectory(quintic(READY + 0.3, 1.0))


def lead(following, phase):
    """As far as a phase, its owner alive."""
    for each in dict.fromkeys(("pre", phase)):
        following.enter(each)


@given(st.integers(1, 500), st.sampled_from(["approach", "excite"]))
@settings(max_examples=8, deadline=None, derandomize=True)
def test_the_arm_is_at_rest_within_300_ms_of_the_last_heartbeat(last, phase):
    """At up to 1.5 rad/s, wherever on the way the owner of the phase dies."""
    arm = Arm(Controller())
    following, losses = RealtimeCommandInput(arm.controller), []
    lead(following, phase)
    following.trajectory(quintic(READY + 0.8 * np.array([1, 0.5, 1, -0.5, 1, 1, 1]), 1.0))
    for period in range(last + 200):
        if period <= last:
            following.heartbeat(phase)
        try:
            following.check_owner()
        except Refusal as refusal:
            losses.append(refusal)
        arm.step()
        if period > last + 150:
            assert np.abs(arm.dq).max() < LIMITS.rest_speed
    assert len(losses) == 1 and losses[0].reason is Reason.HEARTBEAT
    assert f"episode/heartbeat in phase {phase}" in str(losses[0])
    if phase == "approach":  # an experiment's plan is sent by the owner itself
        with pytest.raises(Refusal, match="heartbeat"):
            following.trajectory(quintic(arm.q, 1.0))


@pytest.mark.parametrize("gap", [60, 63])  # periods: 120 ms, 126 ms
def test_a_trajectory_goes_on_as_long_as_heartbeats_come(gap):
    following = RealtimeCommandInput(controller := Controller(limits=replace(LIMITS, press=np.inf)))
    answers(controller, 1)
    lead(following, "approach")
    following.trajectory(quintic(READY + 0.3, 1.0), 0)
    for period in range(1, 500):
        if period % gap == 0:
            following.heartbeat("approach")
            following.heartbeat("pre")  # of another phase than the one in force
        try:
            following.check_owner()
        except Refusal:
            assert gap == 63
        answers(controller, 1, first=period)
    assert (np.abs(answers(controller, 1, first=500)[0].position - READY - 0.3).max() < 1e-6) == (gap == 60)


@pytest.mark.parametrize("phase", ["pre", "approach", "post"])
def test_a_plan_that_comes_when_the_owner_is_no_more_is_refused(phase):
    """Also where the owner has been started again, and says that nothing is under way."""
    following = RealtimeCommandInput(controller := Controller())
    answers(controller, 1)
    lead(following, phase)
    answers(controller, 80, first=1)
    with pytest.raises(Refusal, match="heartbeat: expected episode/heartbeat in phase"):
        following.trajectory(quintic(READY + 0.3, 1.0))
    following.enter("idle")
    with pytest.raises(Refusal, match="expected an episode under way"):
        following.trajectory(quintic(READY + 0.3, 1.0))
    following.enter("pre")
    following.trajectory(quintic(READY + 0.3, 1.0))


def test_without_an_episode_everything_is_followed():
    following = RealtimeCommandInput(controller := Controller())
    answers(controller, 1)
    following.begin()
    following.trajectory(quintic(READY + 0.3, 1.0))
    following.enter("idle")
    following.trajectory(quintic(READY + 0.3, 1.0))


TICK = 50 * PERIOD


def test_the_gate_opens_only_for_what_belongs_to_the_tick():
    gate = LockstepCommandInput(TICK)
    assert gate.missing(TICK + PERIOD) is None and gate.take(TICK + PERIOD) is None
    gate.trajectory(TICK, "plan of this tick")
    gate.tick(0, PhaseState("approach"))
    assert gate.missing(TICK) == "episode/tick"
    gate.tick(TICK, PhaseState("approach"))
    assert gate.missing(TICK) is None
    assert gate.take(TICK).trajectory == ("plan of this tick", None)
    gate.tick(2 * TICK, PhaseState("approach"))
    assert gate.missing(2 * TICK) is None and gate.take(2 * TICK).trajectory is None  # it runs already
    gate.tick(3 * TICK, PhaseState("post"))
    gate.pose(2 * TICK, "pose of another tick")
    assert gate.missing(3 * TICK) == "target_pose"
    gate.pose(3 * TICK, "pose")
    assert gate.missing(3 * TICK) == "target_gains"
    gate.gains("gains")
    assert gate.missing(3 * TICK) is None
    assert gate.take(3 * TICK).target == ("pose", "gains")
    gate.tick(4 * TICK, PhaseState("post"))
    gate.pose(4 * TICK, "pose")
    assert gate.missing(4 * TICK) == "target_gains"  # those of the target before are used up
    gate.tick(5 * TICK, PhaseState("post"))
    gate.gains("gains")
    assert gate.missing(5 * TICK) == "target_pose"


def test_the_gate_waits_for_a_plan_in_every_episode():
    gate = LockstepCommandInput(TICK)
    for start in (0, 10 * TICK):
        gate.tick(start, PhaseState("pre"))
        assert gate.missing(start) is None
        gate.take(start)
        gate.tick(start + TICK, PhaseState("approach"))
        assert gate.missing(start + TICK) == "joint_trajectory"
        gate.trajectory(start + TICK, None)
        assert gate.missing(start + TICK) is None
        assert gate.take(start + TICK).trajectory is None


def test_the_gate_pairs_each_experiment_with_its_gains():
    gate = LockstepCommandInput(TICK)
    for number, name in enumerate(("dwell", "chirp")):
        experiment = PhaseState("excite", experiment=name)
        start = 4 * number * TICK
        gate.tick(start, experiment)
        assert gate.missing(start) == "joint_trajectory"
        gate.trajectory(start, name)
        assert gate.missing(start) == "target_gains"
        gate.gains(number)
        assert gate.missing(start) is None
        assert gate.take(start).trajectory == (name, number)
        gate.tick(start + TICK, experiment)
        assert gate.missing(start + TICK) is None and gate.take(start + TICK).trajectory is None


@pytest.mark.parametrize("plan, gains", [(None, "gains"), ("plan", None)])
def test_a_refused_half_of_an_experiment_answers_the_tick_but_moves_nothing(plan, gains):
    gate = LockstepCommandInput(TICK)
    gate.tick(TICK, PhaseState("excite", experiment="dwell"))
    gate.trajectory(TICK, plan)
    gate.gains(gains)
    assert gate.missing(TICK) is None
    assert gate.take(TICK).trajectory is None


def test_a_refused_half_of_a_target_answers_the_tick_but_moves_nothing():
    gate = LockstepCommandInput(TICK)
    gate.tick(TICK, PhaseState("post"))
    gate.gains(None)
    gate.pose(TICK, "pose")
    assert gate.missing(TICK) is None
    assert gate.take(TICK).target is None
