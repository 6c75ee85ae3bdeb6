"""Guards, command validation and the safety filter."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from np_control.impedance import DAMPING_RATIO_MAX, DAMPING_RATIO_MIN, STIFFNESS_MAX, STIFFNESS_MIN
from np_control.safety import (
    LIMITS,
    Reason,
    Refusal,
    SafetyFilter,
    State,
    check_command,
    limit_gains,
    limit_target,
    limit_torque,
    slew_gains,
    torque_bounds,
    velocity_bounds,
)
from np_control.safety.refusals import check_finite
from np_description.panda import JOINT_NAMES, NOMINAL

PERIOD = LIMITS.period_ns
ZERO = np.zeros(7)
READY = NOMINAL.ready


def joint_arrays(low, high):
    return arrays(float, 7, elements=st.floats(low, high, width=64))


def scaled(limit):
    """Vectors within +-limit, one scale a joint."""
    return joint_arrays(-1, 1).map(lambda unit: unit * limit)


positions = joint_arrays(-3.1, 3.8).map(lambda q: np.clip(q, LIMITS.position_lower, LIMITS.position_upper))
velocities = scaled(2 * LIMITS.velocity)
any_torque = joint_arrays(-1e6, 1e6)
allowed_torque = scaled(LIMITS.torque)


@given(any_torque, allowed_torque, positions, velocities)
def test_torque_and_rate_limits_always_hold(torque, previous, q, dq):
    limited, _ = limit_torque(LIMITS, torque, previous, q, dq)
    assert (np.abs(limited) <= LIMITS.torque).all()
    assert (np.abs(limited - previous) <= LIMITS.torque_rate * LIMITS.period + 1e-9).all()


@given(any_torque, allowed_torque, positions, velocities)
def test_guarding_twice_changes_nothing(torque, previous, q, dq):
    once, _ = limit_torque(LIMITS, torque, previous, q, dq)
    twice, _ = limit_torque(LIMITS, once, previous, q, dq)
    np.testing.assert_array_equal(once, twice)


@given(allowed_torque, positions)
def test_small_torque_at_rest_amid_the_range_passes_unchanged(torque, q):
    amid = 0.8 * (LIMITS.position_lower + LIMITS.position_upper) / 2 + 0.2 * q
    small = torque * 0.2
    limited, changed = limit_torque(LIMITS, small, small, amid, ZERO)
    np.testing.assert_array_equal(limited, small)
    assert changed == []


@pytest.mark.parametrize("arms", [1, 2, 5])
def test_many_arms_are_guarded_as_one_is(arms):
    """The blind test's generator moves them side by side; two of them are not the two sides of a bound."""
    rng = np.random.default_rng(arms)
    q = rng.uniform(NOMINAL.position_lower - 0.1, NOMINAL.position_upper + 0.1, (arms, 7))
    dq, wanted, previous = (scale * rng.normal(size=(arms, 7)) for scale in (1.5, 60.0, 5.0))
    together, _ = limit_torque(LIMITS, wanted, previous, q, dq)
    for row, one in enumerate(together):
        assert np.array_equal(one, limit_torque(LIMITS, wanted[row], previous[row], q[row], dq[row])[0])
    by_rows, _ = limit_torque(LIMITS, *(array[:, None] for array in (wanted, previous, q, dq)))
    assert np.array_equal(by_rows[:, 0], together)


@given(positions, velocities)
def test_bounds_are_ordered_and_point_away_from_walls(q, dq):
    slowest, fastest = velocity_bounds(LIMITS, q)
    lower, upper = torque_bounds(LIMITS, q, dq)
    assert (slowest <= fastest).all() and (lower <= upper).all()
    assert (fastest[q > LIMITS.position_upper - LIMITS.wall_margin] <= 0).all()
    assert (slowest[q < LIMITS.position_lower + LIMITS.wall_margin] >= 0).all()
    assert (upper[dq >= fastest] <= 0).all() and (lower[dq <= slowest] >= 0).all()


@given(positions, velocities)
def test_torque_towards_a_bound_can_be_taken_back_before_the_bound(q, dq):
    """Taken back at the torque rate it adds tau^2 / (2 rate inertia) to the speed of the lightest joint, as `torque_bounds` promises."""
    slowest, fastest = velocity_bounds(LIMITS, q)
    lower, upper = torque_bounds(LIMITS, q, dq)
    added = np.square([lower, upper]) / (2 * LIMITS.torque_rate * LIMITS.inertia)
    inside = (slowest < dq) & (dq < fastest)
    assert (dq + added[1] <= fastest + 1e-9)[inside].all() and (dq - added[0] >= slowest - 1e-9)[inside].all()


@given(positions, velocities)
def test_beyond_a_bound_braking_is_owed(q, dq):
    """In proportion to the excess, up to the torque limit, however hard it is to take back; and no more."""
    slowest, fastest = velocity_bounds(LIMITS, q)
    lower, upper = torque_bounds(LIMITS, q, dq)
    for excess, braking in ((dq - fastest, -upper), (slowest - dq, lower)):
        owed = np.minimum(LIMITS.torque * excess / (LIMITS.speed_fraction * LIMITS.velocity), LIMITS.torque)
        np.testing.assert_allclose(braking[excess > 0], owed[excess > 0], atol=1e-9)


def test_the_workspace_is_before_the_base_and_a_target_behind_it_is_refused():
    for x in (-0.5, 0.0, 0.05):
        with pytest.raises(Refusal) as refusal:
            limit_target(LIMITS, np.array([x, 0.0, 0.3]))
        assert refusal.value.reason is Reason.WORKSPACE


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused(bad):
    broken = ZERO.copy()
    broken[3] = bad
    for arguments in ((broken, ZERO, READY, ZERO), (ZERO, ZERO, broken, ZERO), (ZERO, ZERO, READY, broken)):
        with pytest.raises(Refusal, match="expected finite") as refusal:
            limit_torque(LIMITS, *arguments)
        assert refusal.value.reason is Reason.NOT_FINITE
    with pytest.raises(Refusal):
        limit_target(LIMITS, np.array([0.5, bad, 0.1]))
    with pytest.raises(Refusal):
        limit_gains(broken, np.ones(7))
    check_finite(large=np.full(7, 1e200))  # though their squares are infinite


@given(arrays(float, 3, elements=st.floats(-2, 2)))
def test_targets_end_in_the_workspace_or_are_refused(position):
    nearest = np.clip(position, LIMITS.workspace_lower, LIMITS.workspace_upper)
    try:
        limited, clamped = limit_target(LIMITS, position)
    except Refusal as refusal:
        assert refusal.reason is Reason.WORKSPACE
        assert np.linalg.norm(position - nearest) > LIMITS.workspace_slack
    else:
        np.testing.assert_array_equal(limited, nearest)
        assert clamped == (position != nearest).any()


def test_gains_outside_their_bounds_are_refused_but_rounding_is_not():
    rounded = STIFFNESS_MAX.astype(np.float32) * np.float32(1 + 1e-6)
    stiffness, ratio = limit_gains(rounded, np.full(7, DAMPING_RATIO_MIN))
    assert (stiffness <= STIFFNESS_MAX).all() and (ratio >= DAMPING_RATIO_MIN).all()
    for stiffness, ratio in (
        (STIFFNESS_MAX * 1.1, np.ones(7)),
        (-STIFFNESS_MIN, np.ones(7)),
        (STIFFNESS_MIN, np.full(7, 0.4)),
    ):
        with pytest.raises(Refusal) as refusal:
            limit_gains(stiffness, ratio)
        assert refusal.value.reason is Reason.GAINS


def test_gains_reach_their_target_within_the_slew_time_and_never_jump():
    gains = np.stack([STIFFNESS_MIN, np.full(7, DAMPING_RATIO_MIN)])
    target = np.stack([STIFFNESS_MAX, np.full(7, DAMPING_RATIO_MAX)])
    span = target - gains
    for _ in range(int(np.ceil(1 / (LIMITS.gain_slew * LIMITS.period)))):
        moved = slew_gains(LIMITS, gains, target, LIMITS.period)
        assert (moved - gains <= LIMITS.gain_slew * LIMITS.period * span + 1e-9).all()
        gains = moved
    np.testing.assert_allclose(gains, target)


def command(**changes):
    fields = dict(stamp=10 * PERIOD, names=list(JOINT_NAMES), position=READY, velocity=ZERO, effort=ZERO)
    return fields | changes


def changed(array, index, value):
    array = np.array(array, dtype=float)
    array[index] = value
    return array


@pytest.mark.parametrize(
    "reason, change",
    [
        (Reason.NAMES, dict(names=list(JOINT_NAMES[::-1]))),
        (Reason.NAMES, dict(names=[])),
        (Reason.LENGTH, dict(effort=np.zeros(6))),
        (Reason.LENGTH, dict(velocity=[])),
        (Reason.NOT_FINITE, dict(effort=changed(ZERO, 2, np.nan))),
        (Reason.NOT_FINITE, dict(position=changed(READY, 6, np.inf))),
        (Reason.FUTURE, dict(stamp=11 * PERIOD)),
        (Reason.ORDER, dict(stamp=8 * PERIOD)),
        (Reason.POSITION, dict(position=changed(READY, 3, 0.0))),
        (Reason.VELOCITY, dict(velocity=changed(ZERO, 0, 2.2))),
        (Reason.TORQUE, dict(effort=changed(ZERO, 6, -12.1))),
    ],
)
def test_each_bad_command_is_refused_for_its_reason(reason, change):
    with pytest.raises(Refusal) as refusal:
        check_command(LIMITS, **command(**change), now=10 * PERIOD, last=9 * PERIOD)
    assert refusal.value.reason is reason


def test_a_command_may_be_three_periods_late_and_no_more():
    check_command(LIMITS, **command(stamp=7 * PERIOD), now=10 * PERIOD)
    with pytest.raises(Refusal, match="4 periods old, allowed are 3") as refusal:
        check_command(LIMITS, **command(stamp=6 * PERIOD), now=10 * PERIOD)
    assert refusal.value.reason is Reason.LATE


@given(positions, scaled(LIMITS.velocity), allowed_torque)
def test_every_command_within_the_limits_is_accepted(q, dq, torque):
    lists = command(position=q.tolist(), velocity=dq.tolist(), effort=torque.tolist())
    accepted = check_command(LIMITS, **lists, now=10 * PERIOD, last=10 * PERIOD)
    np.testing.assert_array_equal(accepted.effort, torque)
    np.testing.assert_array_equal(accepted.position, q)


def started():
    safety = SafetyFilter()
    safety.start(READY)
    return safety


def test_the_first_command_must_hold_the_measured_pose():
    safety = started()
    assert safety.refusals.last == "" and safety.refusals.total == 0
    with pytest.raises(Refusal, match="first target of panda_joint1: expected the measured position"):
        safety.offer(**command(position=READY + [0.2, 0, 0, 0, 0, 0, 0]), now=10 * PERIOD)
    assert safety.state is State.READY and safety.refusals.nonzero() == {"start": 1}
    safety.offer(**command(), now=10 * PERIOD)
    assert safety.state is State.MOVING


def test_a_refused_command_changes_nothing_but_its_counter():
    safety = started()
    effort = np.full(7, 1.0)
    safety.offer(**command(effort=effort), now=10 * PERIOD)
    with pytest.raises(Refusal):
        safety.offer(**command(effort=np.full(7, np.nan)), now=10 * PERIOD)
    np.testing.assert_array_equal(safety.apply(10 * PERIOD, READY, ZERO).torque, effort)
    assert safety.refusals.nonzero() == {"not_finite": 1} and "not_finite" in safety.refusals.last


def test_silence_first_holds_the_last_target_then_stops_for_good():
    safety = started()
    now = 10 * PERIOD
    target = READY + 0.05
    safety.offer(**command(position=target), now=now)
    assert safety.apply(now + 3 * PERIOD, READY, ZERO).state is State.MOVING
    held = safety.apply(now + 4 * PERIOD, READY, ZERO)
    assert held.state is State.HOLDING and (held.torque > 0).all()
    np.testing.assert_array_equal(held.position, target)
    late = 14 * PERIOD
    safety.offer(**command(stamp=late, position=target), now=late)  # a hiccup: commands resume by themselves
    assert safety.apply(late, READY, ZERO).state is State.MOVING
    assert safety.apply(late + LIMITS.silence_ns - 1, READY, ZERO).state is State.HOLDING
    assert safety.apply(late + LIMITS.silence_ns, READY, ZERO).state is State.STOPPED
    after = late + LIMITS.silence_ns + PERIOD
    with pytest.raises(Refusal, match="silence") as refusal:
        safety.offer(**command(stamp=after), now=after)
    assert refusal.value.reason is Reason.STATE
    safety.recover(READY)
    safety.offer(**command(stamp=after), now=after)
    assert safety.apply(after, READY, ZERO).state is State.MOVING


def test_recovery_is_refused_while_the_arm_moves_or_has_not_been_seen():
    safety = started()
    safety.stop("test")
    with pytest.raises(Refusal, match="still moves"):
        safety.recover(READY)
    safety.apply(0, READY, np.full(7, 0.2))
    with pytest.raises(Refusal, match="still moves"):
        safety.recover(READY)
    safety.apply(PERIOD, READY, np.full(7, 0.01))
    safety.recover(READY)
    assert safety.state is State.READY


@given(positions)
def test_recovery_holds_the_arm_where_it_is_now(moved):
    """Someone may have moved it since the last period."""
    safety = started()
    safety.offer(**command(stamp=12 * PERIOD), now=12 * PERIOD)
    safety.apply(12 * PERIOD, READY, ZERO)
    safety.stop("test")
    safety.recover(moved)
    held = safety.apply(13 * PERIOD, moved, ZERO)
    np.testing.assert_array_equal(held.position, moved)
    assert held.state is State.READY


def pushed(safety):
    """Under a torque that takes many periods to build up, then stopped, at rest; that torque."""
    effort = np.full(7, 10.0)
    for k in range(10, 20):
        safety.offer(**command(stamp=k * PERIOD, effort=effort), now=k * PERIOD)
        torque = safety.apply(k * PERIOD, READY, ZERO).torque
    np.testing.assert_array_equal(torque, effort)
    safety.stop("test")
    return torque


@pytest.mark.parametrize("applied", [None, ZERO, np.full(7, 3.0)])
def test_torque_goes_on_after_recovery_from_what_is_on_the_arm(applied):
    safety = started()
    before = pushed(safety)
    safety.recover(READY, applied=applied)
    torque = safety.apply(20 * PERIOD, READY, ZERO).torque
    step = LIMITS.torque_rate * LIMITS.period
    np.testing.assert_allclose(torque, np.maximum((before if applied is None else applied) - step, 0), atol=1e-9)


def test_an_arm_is_slack_once_it_is_at_rest_and_its_torque_a_step_from_none():
    safety = started()
    torque, step = pushed(safety), LIMITS.torque_rate * LIMITS.period
    faded = []
    while torque.any():
        assert safety.is_slack == (np.abs(torque) <= step).all()
        faded.append(torque)
        torque = safety.fade()
    assert len(faded) > 2 and np.abs(np.diff(faded, axis=0)).max() <= step + 1e-9
    safety.apply(20 * PERIOD, READY, np.full(7, 2 * LIMITS.rest_speed))
    assert not safety.is_slack


@pytest.mark.parametrize(
    "q, dq, cause",
    [
        (changed(READY, 1, np.nan), ZERO, "not finite"),
        (READY, changed(ZERO, 4, np.inf), "not finite"),
        (READY, changed(ZERO, 2, 2.3), "panda_joint3: 2.30 rad/s is over"),
        (changed(READY, 3, 0.1), ZERO, "panda_joint4: 0.100 rad is outside"),
        *(
            (changed(READY, i, LIMITS.position_lower[i] - 1e-3), ZERO, f"{name}: ")
            for i, name in enumerate(JOINT_NAMES)
        ),
        *(
            (changed(READY, i, LIMITS.position_upper[i] + 1e-3), ZERO, f"{name}: ")
            for i, name in enumerate(JOINT_NAMES)
        ),
    ],
)
def test_a_broken_state_is_a_fault_and_the_torque_stays_lawful(q, dq, cause):
    safety = started()
    safety.offer(**command(effort=np.full(7, 1.9)), now=10 * PERIOD)
    before = safety.apply(10 * PERIOD, READY, ZERO).torque
    applied = safety.apply(11 * PERIOD, q, dq)
    assert applied.state is State.FAULT and cause in safety.watchdog.cause
    assert np.isfinite(applied.torque).all()
    assert (np.abs(applied.torque - before) <= LIMITS.torque_rate * LIMITS.period + 1e-9).all()
    with pytest.raises(Refusal):
        safety.offer(**command(stamp=11 * PERIOD), now=11 * PERIOD)


@settings(max_examples=50)
@given(st.lists(st.tuples(any_torque, st.booleans()), min_size=1, max_size=20), positions)
def test_whatever_is_offered_the_applied_torque_is_lawful(offers, q):
    safety = SafetyFilter()
    safety.start(q)
    previous = ZERO
    for k, (torque, silent) in enumerate(offers):
        if not silent:
            try:
                safety.offer(**command(stamp=k * PERIOD, position=q, effort=torque), now=k * PERIOD)
            except Refusal as refusal:
                assert (np.abs(torque) > LIMITS.torque).any() and refusal.reason is Reason.TORQUE
        applied = safety.apply(k * PERIOD, q, ZERO)
        assert (np.abs(applied.torque) <= LIMITS.torque).all()
        assert (np.abs(applied.torque - previous) <= LIMITS.torque_rate * LIMITS.period + 1e-9).all()
        previous = applied.torque


def test_a_refusal_survives_the_way_from_another_process():
    refusal = pickle.loads(pickle.dumps(Refusal(Reason.NOT_FINITE, "torque: expected finite numbers")))
    assert refusal.reason is Reason.NOT_FINITE
    assert str(refusal) == "not_finite: torque: expected finite numbers"
