"""Trajectories: interpolation, exact extremes, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from np_control.safety import LIMITS, Reason, Refusal
from np_control.trajectory import Trajectory, make_trajectory
from np_description.panda import NOMINAL


@st.composite
def trajectories(draw):
    count = draw(st.integers(2, 6))
    steps = draw(arrays(float, count, elements=st.floats(0.05, 2)))
    positions = draw(arrays(float, (count, 7), elements=st.floats(-2, 2)))
    velocities = draw(arrays(float, (count, 7), elements=st.floats(-1, 1)))
    return Trajectory(np.cumsum(steps) - steps[0], positions, velocities)


def there_and_back(**changes):
    fields = dict(
        times=np.array([0.0, 1.0, 2.5]),
        positions=NOMINAL.ready + np.array([[0.0], [0.2], [0.1]]),
        velocities=np.array([[0.0], [0.05], [0.0]]) * np.ones(7),
        limits=LIMITS,
    )
    return fields | changes


@given(trajectories())
def test_it_passes_its_points_with_their_velocities(trajectory):
    for time, position, velocity in zip(trajectory.times[:-1], trajectory.positions, trajectory.velocities):
        at, speed = trajectory.sample(time)
        np.testing.assert_allclose(at, position, atol=1e-12)
        np.testing.assert_allclose(speed, velocity, atol=1e-9)


@given(trajectories(), st.floats(0.001, 0.999))
def test_velocity_and_acceleration_are_the_derivatives(trajectory, share):
    k = len(trajectory.times) // 2 - 1
    time = trajectory.times[k] + share * (trajectory.times[k + 1] - trajectory.times[k])
    step = 1e-6
    before, after = (trajectory.sample(t) for t in (time - step, time + step))
    _, velocity, acceleration = trajectory.sample_with_acceleration(time)
    if trajectory.times[k] < time - step and time + step < trajectory.times[k + 1]:
        np.testing.assert_allclose((after[0] - before[0]) / (2 * step), velocity, atol=1e-3)
        np.testing.assert_allclose((after[1] - before[1]) / (2 * step), acceleration, atol=1e-2, rtol=1e-4)


@settings(max_examples=50)
@given(trajectories())
def test_extremes_bound_every_sample_and_are_attained(trajectory):
    samples = [trajectory.sample(t) for t in np.linspace(0, trajectory.duration, 801)[:-1]]
    positions, velocities = (np.array([sample[i] for sample in samples]) for i in (0, 1))
    lower, upper, speed = trajectory.extremes()
    assert (positions >= lower - 1e-9).all() and (positions <= upper + 1e-9).all()
    assert (np.abs(velocities) <= speed + 1e-9).all()
    # Between two of 800 samples of a cubic little is missed.
    everywhere = np.vstack([positions, trajectory.positions])
    assert np.abs(everywhere.min(axis=0) - lower).max() < 0.05
    assert np.abs(everywhere.max(axis=0) - upper).max() < 0.05


@given(trajectories())
def test_a_way_from_rest_to_rest_goes_to_its_points_exactly_and_not_a_bit_beyond(trajectory):
    """A point may lie at a joint's limit."""
    lower, upper, _ = replace(trajectory, velocities=np.zeros_like(trajectory.velocities)).extremes()
    np.testing.assert_array_equal(lower, trajectory.positions.min(axis=0))
    np.testing.assert_array_equal(upper, trajectory.positions.max(axis=0))


@pytest.mark.parametrize("joint", range(7))
def test_a_trajectory_as_fast_as_may_be_is_taken_and_a_faster_one_refused_by_its_joint(joint):
    table = [there_and_back()[name] for name in ("times", "positions", "velocities")]
    speed = Trajectory(*table).extremes()[2]
    make_trajectory(*table, replace(LIMITS, velocity=speed, speed_fraction=1.0))
    less = np.where(np.arange(7) == joint, np.nextafter(speed, 0), speed)
    with pytest.raises(Refusal, match=LIMITS.joints[joint]) as refusal:
        make_trajectory(*table, replace(LIMITS, velocity=less, speed_fraction=1.0))
    assert refusal.value.reason is Reason.VELOCITY


def test_it_rests_before_and_after():
    trajectory = make_trajectory(**there_and_back(times=np.array([0.5, 1.0, 2.5])))
    for time, point in ((0.0, 0), (0.49, 0), (2.5, 2), (99.0, 2)):
        position, velocity = trajectory.sample(time)
        np.testing.assert_array_equal(position, trajectory.positions[point])
        np.testing.assert_array_equal(velocity, np.zeros(7))


def test_a_single_point_is_a_place_to_be():
    trajectory = make_trajectory([0.0], [NOMINAL.ready], [np.zeros(7)], LIMITS)
    np.testing.assert_array_equal(trajectory.sample(1.0)[0], NOMINAL.ready)


@pytest.mark.parametrize(
    "reason, change",
    [
        (Reason.TRAJECTORY, dict(times=[], positions=np.zeros((0, 7)), velocities=np.zeros((0, 7)))),
        (Reason.TRAJECTORY, dict(times=[0.0, 1.0, 1.0])),
        (Reason.TRAJECTORY, dict(times=[0.0, 2.0, 1.0])),
        (Reason.TRAJECTORY, dict(times=[-0.1, 1.0, 2.0])),
        (Reason.TRAJECTORY, dict(times=[0.0, np.nan, 2.0])),
        (Reason.TRAJECTORY, dict(positions=np.zeros((3, 6)))),
        (Reason.TRAJECTORY, dict(velocities=np.full((3, 7), 0.05))),
        (Reason.NOT_FINITE, dict(positions=np.full((3, 7), np.nan))),
        (Reason.POSITION, dict(positions=NOMINAL.ready + np.array([[0.0], [2.5], [0.1]]), times=[0.0, 9.0, 20])),
        (Reason.VELOCITY, dict(times=[0.0, 0.1, 2.5])),
    ],
)
def test_each_bad_trajectory_is_refused_for_its_reason(reason, change):
    make_trajectory(**there_and_back())
    with pytest.raises(Refusal) as refusal:
        make_trajectory(**there_and_back(**change))
    assert refusal.value.reason is reason


def test_a_limit_is_kept_between_the_points_too():
    """Both points are allowed, but the velocities carry joint 4 over its limit in between."""
    low = NOMINAL.ready.copy()
    low[3] = -0.1
    velocities = np.zeros((4, 7))
    velocities[1, 3], velocities[2, 3] = 1.0, -1.0
    with pytest.raises(Refusal, match="panda_joint4") as refusal:
        make_trajectory([0.0, 3.0, 3.5, 6.0], [NOMINAL.ready, low, low, NOMINAL.ready], velocities, LIMITS)
    assert refusal.value.reason is Reason.POSITION
