"""The excitation suite stays where an arm may go, and is what it says."""

import re
from pathlib import Path

import numpy as np
import pytest
from arm_generator import record
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real.diagnosis import explain_gap
from sim2real.excitation.contact_suite.suite import FAMILIES
from sim2real.excitation.motions import chirp, triangle, visits, waves
from sim2real.excitation.suite import FURTHER, NAMES, PAUSE, READY, TICK_NS, end_stamp, make_suite, schedule_starts
from sim2real.thresholds import THRESHOLDS

from np_control.controller import Controller
from np_control.dynamics import Dynamics
from np_control.safety import LIMITS, check_command, torque_bounds, velocity_bounds
from np_description.panda import NOMINAL

PLAN = make_suite()
EVERYTHING = PLAN + make_suite(FURTHER)
DYNAMICS = Dynamics()
moments = st.tuples(st.integers(0, len(EVERYTHING) - 1), st.floats(0, 1))


@settings(deadline=None, max_examples=300)
@given(moments)
def test_every_moment_is_inside_the_limits_with_margin(moment):
    segment = EVERYTHING[moment[0]]
    q, dq, ddq = segment.trajectory.sample_with_acceleration(moment[1] * segment.duration)
    torque = DYNAMICS.feedforward(q, dq, ddq)
    torque = torque + NOMINAL.frictionloss * np.sign(dq) + NOMINAL.damping * dq
    check_command(LIMITS, 0, LIMITS.joints, q, dq, torque, now=0)  # raises where it would be refused
    assert (np.abs(torque) < 0.5 * LIMITS.torque).all()
    slowest, fastest = velocity_bounds(LIMITS, q)
    assert (dq > 0.85 * slowest).all() and (dq < 0.85 * fastest).all()
    lower, upper = torque_bounds(LIMITS, q, dq)
    assert (torque > lower).all() and (torque < upper).all()


@pytest.mark.slow
def test_no_guard_is_needed_to_follow_it():
    """A controller that tracks perfectly asks for no torque that its guards change."""
    for segment in PLAN + make_suite(["long_third", "sweep_4"]):
        controller, limited = Controller(), set()
        controller.observe(0, segment.positions[0], np.zeros(7))
        controller.follow(segment.trajectory, 0, segment.gains)
        for k in range(0, int(segment.duration / LIMITS.period), 1):
            q, dq = segment.trajectory.sample(k * LIMITS.period)
            controller.observe(k * LIMITS.period_ns, q, dq)
            limited.update(controller.answer().limited)
        assert not limited, f"{segment.name}: {limited}"


@pytest.mark.parametrize("guide", ["hardware.md", "diagnose.md", "your_own_backend.md"])
def test_what_a_guide_begins_with_is_motion_enough_to_be_judged(guide):
    text = (Path(__file__).resolve().parents[2] / "docs/guide" / guide).read_text()
    told = [
        names.split() for names in re.findall(r"--only ((?:[a-z]+[a-z_0-9]* ?)+)", text) if names.split()[0] != "each"
    ]
    told = [names for names in told if not names[0].startswith("nudge")]  # is looked at, not judged
    of_arm = [names for names in told if not set(names) <= set(FAMILIES)]  # the others are the task suite's
    assert of_arm
    for names in of_arm:
        assert sum(segment.duration for segment in make_suite(names)) >= THRESHOLDS.blocks.shortest, names


def test_a_recording_that_is_too_short_says_how_much_is_wanted():
    with pytest.raises(ValueError, match="15 s in all; got 4.* s in 1 pieces: record more"):
        explain_gap([record(duration=4.5)], quick=True)


def test_it_takes_under_three_minutes_and_joins_up():
    assert end_stamp(PLAN) < 180e9
    assert {segment.name for segment in PLAN} == {*NAMES, "transfer"}
    assert np.allclose(PLAN[0].positions[0], READY)
    for one, other in zip(PLAN, PLAN[1:]):
        assert np.allclose(one.positions[-1], other.positions[0], atol=1e-6)
    starts = schedule_starts(PLAN, begin=1_234_000_000)
    for start, segment, following in zip(starts, PLAN, starts[1:]):
        assert start % TICK_NS == 0 and following - start >= (segment.duration + PAUSE) * 1e9 - 1
        # At least one tick lies between end and start, for phases to change.
    assert starts[0] >= 1_234_000_000 + PAUSE * 1e9


def test_a_nudge_moves_one_joint_by_five_degrees_and_back():
    (segment,) = make_suite(["nudge_7"])
    moved = np.degrees(segment.positions - READY)
    assert not moved[:, :6].any() and not moved[[0, -1]].any()
    assert moved[:, 6].max() == pytest.approx(5.0) and moved[:, 6].min() == 0.0
    assert np.degrees(np.abs(segment.velocities)).max() < 4.0  # deg/s


def test_parts_of_it_can_be_named():
    assert [s.name for s in make_suite(["dwell"])] == ["dwell"]
    assert [s.name for s in make_suite(["chirp"])] == ["chirp_odd", "chirp_even"]
    assert [s.name for s in make_suite(["sweep_4", "long_chirp"])] == ["long_chirp_odd", "long_chirp_even", "sweep_4"]
    assert not set(FURTHER) & set(NAMES)
    assert [s.name for s in make_suite(["third_dwell", "dwell"])] == ["dwell", "transfer", "third_dwell"]
    assert [s.name for s in make_suite(["dwell"], start=READY + 0.05)] == ["transfer", "dwell"]
    with pytest.raises(ValueError, match="'dwel': expected one of reference"):
        make_suite(["dwel"])
    assert {tuple(s.gains[1]) for s in make_suite(["low_damping"])} == {(0.5,) * 7}


def motions():
    speed = np.linspace(0.1, 0.7, 7)
    return {
        "waves": (6.0, waves(6.0, 0.1 * np.ones((2, 7)), np.full((2, 7), 0.4), np.ones((2, 7)))),
        "chirp": (5.0, chirp(5.0, speed, (0.3, 6.0), 0.2)),
        "triangle": triangle(1.0, speed, 0.3, 2),
        "visits": visits([speed, -speed], 0.8, 0.4),
    }


@pytest.mark.parametrize("name", motions())
def test_motions_begin_and_end_at_rest_and_their_velocity_is_the_derivative(name):
    duration, motion = motions()[name]
    time = np.linspace(0, duration, 20001)
    offset, velocity = motion(time)
    assert np.abs(offset[[0, -1]]).max() < 1e-9 and np.abs(velocity[[0, -1]]).max() < 1e-9
    assert np.abs(np.gradient(offset, time, axis=0) - velocity)[2:-2].max() < 2e-3


def test_a_triangle_holds_its_speed_between_reversals():
    speed = np.linspace(0.1, 0.7, 7)
    duration, motion = triangle(2.0, speed, 0.2, 3)
    _, velocity = motion(np.linspace(0, duration, 5001))
    held = np.abs(np.abs(velocity[:, 0]) - speed[0]) < 1e-9
    assert held.mean() > 0.85
    with pytest.raises(ValueError, match="shorter than a stroke"):
        triangle(0.2, speed, 0.3, 1)
