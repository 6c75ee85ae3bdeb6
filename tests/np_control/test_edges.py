"""Guards and rules exactly at their bound, and one step beyond. Bounds are chosen that floating point holds exactly."""

from dataclasses import replace

import numpy as np
import pytest

from np_control.controller import Controller, ControllerConfig
from np_control.dynamics import Dynamics
from np_control.impedance import DAMPING_RATIO_MIN, STIFFNESS_MAX, STIFFNESS_MIN, damping
from np_control.kinematics import forward_kinematics, jacobian
from np_control.lockstep_input import LockstepCommandInput
from np_control.realtime_input import HEARTBEAT_NS, RealtimeCommandInput
from np_control.safety import LIMITS, Reason, Refusal, SafetyFilter, State, Watchdog, limit_gains, limit_target
from np_control.safety.press import LEVER, press_force_scale, tip_force
from np_control.trajectory import Trajectory, make_trajectory
from np_description.panda import NOMINAL
from np_description.phases import PhaseState

PERIOD = LIMITS.period_ns
ZERO = np.zeros(7)
READY = np.round(NOMINAL.ready * 8) / 8
GAINS = STIFFNESS_MIN, np.ones(7)


def refused(reason, act, *arguments, **options):
    with pytest.raises(Refusal) as refusal:
        act(*arguments, **options)
    assert refusal.value.reason is reason


@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("side", [-1, 1])
def test_a_state_at_a_limit_is_no_fault_and_the_next_number_is(joint, side):
    position = (LIMITS.position_lower if side < 0 else LIMITS.position_upper)[joint]
    for is_speed, limit in ((False, position), (True, side * LIMITS.velocity[joint])):
        for value, state in ((limit, State.READY), (np.nextafter(limit, side * np.inf), State.FAULT)):
            safety, q, dq = SafetyFilter(), READY.copy(), ZERO.copy()
            safety.start(READY)
            (dq if is_speed else q)[joint] = value
            assert safety.apply(PERIOD, q, dq).state is state
            assert safety.watchdog.cause.startswith(LIMITS.joints[joint] if state is State.FAULT else "started")


def test_an_arm_at_its_rest_speed_is_not_at_rest():
    safety = SafetyFilter()
    safety.start(READY)
    for speed, rests in (
        (LIMITS.rest_speed, False),
        (-LIMITS.rest_speed, False),
        (np.nextafter(LIMITS.rest_speed, 0), True),
    ):
        safety.apply(PERIOD, READY, np.full(7, speed))
        assert safety.at_rest is rests


def test_a_filter_counts_the_periods_in_which_each_guard_acts():
    safety = SafetyFilter()
    safety.start(READY)
    assert safety.limited == {"wall_or_speed": 0, "torque": 0, "torque_rate": 0}
    for n in range(1, 4):
        safety.offer(n * PERIOD, LIMITS.joints, READY, ZERO, LIMITS.torque, now=n * PERIOD)
        assert safety.apply(n * PERIOD, READY, ZERO).limited
        assert safety.limited["torque_rate"] == n and safety.limited["torque"] == 0


def test_a_first_target_at_the_tolerance_is_taken():
    limits = replace(LIMITS, start_tolerance=0.125)
    for shift, taken in ((0.125, True), (-0.125, True), (0.25, False), (-0.25, False)):
        safety = SafetyFilter(limits)
        safety.start(READY)
        arguments = PERIOD, limits.joints, READY + shift * np.eye(7)[1], ZERO, ZERO
        if taken:
            safety.offer(*arguments, now=PERIOD)
        else:
            refused(Reason.START, safety.offer, *arguments, now=PERIOD)


@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("side", [-1, 1])
def test_a_trajectory_that_begins_too_far_from_one_joint_is_refused_by_its_name(joint, side):
    controller = Controller(limits=replace(LIMITS, start_tolerance=0.125))
    controller.observe(0, READY, ZERO)
    for shift, refuses in ((0.125, False), (0.25, True)):
        path = Trajectory(np.zeros(1), READY[None] + side * shift * np.eye(7)[joint], np.zeros((1, 7)))
        if refuses:
            with pytest.raises(Refusal, match=f"begins with {LIMITS.joints[joint]} at .* 0.250 rad from") as refusal:
                controller.follow(path)
            assert refusal.value.reason is Reason.START
        else:
            controller.follow(path)


def test_a_backend_starts_idle_and_says_what_led_to_each_state():
    dog = Watchdog(LIMITS)
    assert (dog.state, dog.cause, dog.may_move) == (State.IDLE, "not started", False)
    for act, state, cause in (
        (dog.start, State.READY, "started"),
        (lambda: dog.command(PERIOD), State.MOVING, "commanded"),
        (lambda: dog.fault("broken"), State.FAULT, "broken"),
        (lambda: dog.fault("more"), State.FAULT, "broken"),
        (dog.stop, State.STOPPED, "stop requested"),
        (lambda: dog.recover(True), State.READY, "recovered"),
    ):
        act()
        assert (dog.state, dog.cause) == (state, cause)


def test_a_target_as_far_outside_as_may_be_is_cut_and_the_next_is_refused():
    limits = replace(LIMITS, workspace_slack=0.5)
    inside, was_cut = limit_target(limits, np.array([0.5, -1.0, 0.25]))
    assert was_cut and inside.tolist() == [0.5, -0.5, 0.25]
    assert limit_target(limits, np.array([0.5, 0.5, 0.25]))[1] is False
    refused(Reason.WORKSPACE, limit_target, limits, np.array([0.5, np.nextafter(-1.0, -2), 0.25]))
    refused(Reason.WORKSPACE, limit_target, limits, np.array([0.5, -0.875, 1.25]))  # 0.59 m by the diagonal


def test_a_gain_a_thousandth_of_its_range_outside_is_cut_and_twice_that_is_refused():
    span = STIFFNESS_MAX - STIFFNESS_MIN
    stiffness, ratio = limit_gains(STIFFNESS_MAX + 0.9e-3 * span, np.full(7, DAMPING_RATIO_MIN - 1e-3))
    np.testing.assert_array_equal(stiffness, STIFFNESS_MAX)
    np.testing.assert_array_equal(ratio, np.full(7, DAMPING_RATIO_MIN))
    for off in (-2e-3, 2e-3):
        beyond = np.where(np.arange(7) == 3, (STIFFNESS_MIN if off < 0 else STIFFNESS_MAX) + off * span, STIFFNESS_MIN)
        refused(Reason.GAINS, limit_gains, beyond, np.ones(7))


def test_the_press_is_the_force_and_never_less_than_a_torque_of_its_lever():
    gentle = LEVER * LIMITS.press
    assert press_force_scale(LIMITS, READY, gentle * np.eye(7)[1]) == 1.0
    torque = 40.0 * np.eye(7)[1]
    share = press_force_scale(LIMITS, READY, torque)
    assert share < 1 and np.linalg.norm(tip_force(READY, share * torque)) == pytest.approx(LIMITS.press)
    turn = 40.0 * np.eye(7)[6]  # the hand about its own axis: nothing presses
    assert press_force_scale(LIMITS, READY, turn) == 1.0
    no_force_at_all = np.array([-1.875, -1.25, 0.25, -1.0, -1.25, 1.0, -1.75])  # not even one by rounding
    assert press_force_scale(LIMITS, no_force_at_all, turn) == 1.0
    stretched = 1e-2 + ZERO  # a small torque is a large force there
    torque = 40.0 * np.linalg.svd(jacobian(stretched)[:3])[2][2]
    assert np.linalg.norm(tip_force(stretched, torque)) > 300  # N
    assert press_force_scale(LIMITS, stretched, torque) == pytest.approx(gentle / 40.0)


@pytest.mark.parametrize("gap, begins", [(0, True), (1, False), (200_000_000, False), (200_000_001, True), (-1, True)])
def test_a_gap_that_is_too_long_is_a_beginning(gap, begins):
    controller = Controller()
    controller.observe(10**9, READY, ZERO)
    assert controller.observe(10**9 + gap, READY + 1e-9, ZERO) == begins


def test_a_joint_that_went_as_far_as_it_can_is_no_beginning():
    reach = 2 * LIMITS.velocity * PERIOD * 1e-9 + 1e-3
    for joint in range(7):
        for sign in (-1, 1):
            for off, begins in ((0.999 * reach, False), (1.001 * reach, True)):
                controller = Controller()
                controller.observe(0, ZERO, ZERO)
                assert controller.observe(PERIOD, sign * off * np.eye(7)[joint], ZERO) == begins


def test_a_state_as_large_as_may_be_is_taken_and_a_larger_one_refused_by_its_name():
    for q, dq, reason in ((100.0, 0.0, Reason.POSITION), (0.0, 1000.0, Reason.VELOCITY)):
        controller = Controller()
        assert controller.observe(0, q * np.eye(7)[2], -dq * np.eye(7)[2])
        refused(reason, controller.observe, PERIOD, 1.01 * q * np.eye(7)[2], -1.01 * dq * np.eye(7)[2])
        assert controller.stamp == 0


@pytest.mark.parametrize(
    "age, reason",
    [(500_000_000, None), (500_000_001, Reason.LATE), (-200_000_000, None), (-200_000_001, Reason.FUTURE)],
)
def test_a_target_is_taken_up_to_the_age_and_the_lead_that_it_may_have(age, reason):
    controller = Controller()
    controller.observe(10**9, READY, ZERO)
    target = 10**9 - age, *forward_kinematics(READY), *GAINS
    if reason:
        refused(reason, controller.set_target, *target)
    else:
        assert controller.set_target(*target) is False
        assert controller.set_target(*target) is False  # the same state may be answered twice


def test_a_target_that_is_missed_by_more_than_may_be_is_refused():
    position, rotation = forward_kinematics(READY)
    for change, reason in (
        ({"reach_position": 1e-9}, Reason.UNREACHABLE),
        ({"reach_angle": 1e-9}, Reason.UNREACHABLE),
        ({}, None),
    ):
        controller = Controller(ControllerConfig(**change))
        controller.observe(0, READY, ZERO)
        target = 0, position + [0.05, 0.05, 0], rotation, *GAINS
        if reason:
            refused(reason, controller.set_target, *target)
        else:
            controller.set_target(*target)


def test_a_trajectory_is_followed_from_its_stamp_on_and_ends_what_was_followed():
    controller = Controller(limits=replace(LIMITS, press=np.inf))
    controller.observe(0, READY, ZERO)
    assert controller.stamp == 0 and not controller.follows_trajectory
    path = Trajectory(np.array([0.0, 0.25]), np.stack([READY, READY + 0.125]), np.zeros((2, 7)))
    controller.follow(path, 10 * PERIOD)
    assert controller.follows_trajectory
    for n in range(1, 150):
        controller.observe(n * PERIOD, READY, ZERO)
        answer = controller.answer()
        expected = path.sample(max(0, n - 10) * PERIOD * 1e-9)
        np.testing.assert_allclose(answer.position, expected[0], atol=1e-12)
        np.testing.assert_allclose(answer.velocity, expected[1], atol=1e-9)
    assert not controller.follows_trajectory


@pytest.mark.parametrize("late, is_lost", [(0, False), (1, True)])
def test_an_owner_is_lost_after_the_time_of_a_heartbeat(late, is_lost):
    controller = Controller()
    following = RealtimeCommandInput(controller)
    controller.observe(0, READY, ZERO)
    following.enter("pre")
    following.enter("approach")
    following.heartbeat("post")  # of another phase than the one in force
    controller.observe(HEARTBEAT_NS + late, READY, ZERO)
    if is_lost:
        refused(Reason.HEARTBEAT, following.check_owner)
        refused(Reason.HEARTBEAT, following.check_open)
        following.check_owner()  # once for each loss
    following.heartbeat("approach")
    following.check_owner()
    following.check_open()


def test_an_arm_that_comes_back_has_the_time_of_a_heartbeat_from_its_first_state_on():
    controller = Controller()
    following = RealtimeCommandInput(controller)
    controller.observe(0, READY, ZERO)
    following.enter("approach")
    following.begin()
    for stamp in (10**9, 10**9 + HEARTBEAT_NS):
        controller.observe(stamp, READY, ZERO)
        following.check_owner()
    controller.observe(10**9 + HEARTBEAT_NS + 1, READY, ZERO)
    refused(Reason.HEARTBEAT, following.check_owner)


def test_nothing_is_answered_or_followed_before_the_first_state():
    controller = Controller()
    path = Trajectory(np.zeros(1), READY[None], np.zeros((1, 7)))
    assert controller.stamp is None
    refused(Reason.STATE, controller.answer)
    refused(Reason.STATE, controller.follow, path)
    refused(Reason.STATE, controller.set_target, 0, *forward_kinematics(READY), *GAINS)


def test_the_torque_of_a_stop_is_that_of_the_law_and_of_its_targets_acceleration():
    controller = Controller(limits=replace(LIMITS, press=np.inf))
    controller.observe(0, READY, ZERO)
    controller.follow(Trajectory(np.array([0.0, 1.0]), np.stack([READY, READY + 0.3]), np.zeros((2, 7))), 0)
    answers = []
    for n in range(1, 170):
        controller.observe(n * PERIOD, READY, ZERO)
        answers.append(controller.answer())
        if n == 100:
            controller.stop()
    velocities = np.array([answer.velocity for answer in answers])
    stiffness, ratio = STIFFNESS_MAX, np.ones(7)
    for n in range(102, 158):
        acceleration = (velocities[n + 1] - velocities[n - 1]) / (2 * LIMITS.period)
        law = stiffness * (answers[n].position - READY) + damping(stiffness, ratio) * velocities[n]
        expected = law + Dynamics().feedforward(READY, ZERO, acceleration)
        np.testing.assert_allclose(answers[n].torque, expected, atol=0.01)  # Nm
    assert not velocities[160:].any()


@pytest.mark.parametrize("stamp, kept", [(100, True), (99, False)])
def test_a_beginning_keeps_what_belongs_to_its_own_tick(stamp, kept):
    gate = LockstepCommandInput(100)
    gate.tick(100, PhaseState("approach"))
    gate.trajectory(100, "plan")
    gate.begin(stamp)
    assert gate.missing(100) == (None if kept else "episode/tick")
    gate.tick(100, PhaseState("approach"))
    assert gate.missing(100) == (None if kept else "joint_trajectory")


def rest(times, positions, velocities=None):
    return (
        np.array(times),
        np.array(positions),
        np.zeros(np.shape(positions)) if velocities is None else np.array(velocities),
    )


def test_a_trajectory_may_touch_the_limits_and_start_late():
    at_limit = np.where(np.arange(7) == 1, LIMITS.position_upper, READY)
    path = make_trajectory(*rest([0.5, 4.5], [READY, at_limit]), LIMITS)
    for time, place in ((0.0, READY), (0.25, READY), (0.5, READY), (4.5, at_limit), (5.0, at_limit)):
        position, velocity, acceleration = path.sample_with_acceleration(time)
        np.testing.assert_array_equal(position, place)
        assert not velocity.any() and (time == 0.5 or not acceleration.any())
    assert path.duration == 4.5
    beyond = np.where(np.arange(7) == 1, np.nextafter(LIMITS.position_upper, 9), READY)
    refused(Reason.POSITION, make_trajectory, *rest([0.5, 4.5], [READY, beyond]), LIMITS)
    below = np.where(np.arange(7) == 1, np.nextafter(LIMITS.position_lower, -9), READY)
    refused(Reason.POSITION, make_trajectory, *rest([0.0, 9.0], [READY, below]), LIMITS)


@pytest.mark.parametrize(
    "times, ends, reason",
    [
        ([-1e-9, 1.0], [0.0, 0.0], Reason.TRAJECTORY),
        ([0.0, 0.0], [0.0, 0.0], Reason.TRAJECTORY),
        ([0.0, np.inf], [0.0, 0.0], Reason.TRAJECTORY),
        ([0.0, 1.0], [1e-3, -1e-3], None),
        ([0.0, 1.0], [1.1e-3, 0.0], Reason.TRAJECTORY),
        ([0.0, 1.0], [0.0, -1.1e-3], Reason.TRAJECTORY),
    ],
)
def test_a_trajectory_begins_and_ends_at_rest(times, ends, reason):
    table = rest(times, [READY, READY], [np.full(7, speed) for speed in ends])
    if reason:
        refused(reason, make_trajectory, *table, LIMITS)
    else:
        make_trajectory(*table, LIMITS)
