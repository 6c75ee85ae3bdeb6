"""What must hold before the arm is moved, and the times of its cycles; no hardware extra needed."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from np_control.impedance import STIFFNESS_MAX
from np_description.calibration import Calibration, CalibrationErrors, Lens
from np_franka.checklist import Checklist, RobotFacts
from np_franka.limits import FR3_LIMITS
from np_franka.timing import LONGEST, RESOLUTION, CycleTimes

NOW = datetime(2026, 11, 21, tzinfo=UTC)
GOOD = RobotFacts("Idle", "", 0.73, 0.0)
CHECKLIST = Checklist("none", timedelta(days=30), STIFFNESS_MAX, np.ones(7), FR3_LIMITS)


def calibration(folder, made):
    """The path of a calibration of that date."""
    Calibration(
        made,
        Lens(640, 480, 600, 600, 320, 240),
        np.array([1, 0, 1]),
        np.array([1, 0, 0, 0]),
        np.eye(6) * 1e-6,
        CalibrationErrors(1e-3, 1e-3, 0.5, 0.2, 20, 500),
    ).save(folder / "calibration.yaml")
    return str(folder / "calibration.yaml")


def test_a_robot_that_is_ready_may_be_moved():
    assert CHECKLIST.problems(GOOD, NOW) == []


def test_of_a_robot_under_control_all_but_its_own_words_is_checked():
    assert CHECKLIST.problems(None, NOW) == []
    assert len(replace(CHECKLIST, calibration="", stiffness=2 * STIFFNESS_MAX).problems(None, NOW)) == 2


@pytest.mark.parametrize(
    "facts, text",
    [
        (replace(GOOD, mode="UserStopped"), "mode is UserStopped, expected Idle"),
        (replace(GOOD, mode="Reflex", errors="joint_reflex"), "joint_reflex"),
        (replace(GOOD, end_effector_mass=0.0), "0.00 kg at its flange"),
        (replace(GOOD, load_mass=0.5), "a load of 0.50 kg"),
    ],
)
def test_mode_and_payload_are_named(facts, text):
    problems = CHECKLIST.problems(facts, NOW)
    assert len(problems) == 1 and text in problems[0]


@pytest.mark.parametrize(
    "changes, text",
    [
        ({"stiffness": 2 * STIFFNESS_MAX}, "stiffness: expected"),
        ({"damping_ratio": np.full(7, 0.1)}, "damping ratio: expected"),
        ({"limits": replace(FR3_LIMITS, period_ns=10_000_000)}, "not stable at 100 Hz"),
    ],
)
def test_gains_that_are_out_of_bounds_or_unstable_at_the_rate_are_named(changes, text):
    problems = replace(CHECKLIST, **changes).problems(GOOD, NOW)
    assert problems and text in problems[0]


def test_a_calibration_must_be_named_readable_and_fresh(tmp_path):
    path = calibration(tmp_path, NOW - timedelta(days=29))
    assert replace(CHECKLIST, calibration=path).problems(GOOD, NOW) == []
    for name, when, text in (
        ("", NOW, "no calibration"),
        (str(tmp_path / "none.yaml"), NOW, "none.yaml"),
        (path, NOW + timedelta(days=2), "31 days old"),
    ):
        problems = replace(CHECKLIST, calibration=name).problems(GOOD, when)
        assert len(problems) == 1 and text in problems[0]


def test_all_that_is_wrong_is_said_at_once():
    assert len(replace(CHECKLIST, calibration="").problems(RobotFacts("Guiding", "", 0.0, 0.0), NOW)) == 3


@given(st.lists(st.floats(1e-4, 0.2), min_size=1, max_size=200), st.floats(0, 100))
def test_percentiles_of_cycles_are_those_of_numpy_to_the_resolution(seconds, percent):
    times = CycleTimes()
    for length in seconds:
        times.add(length)
    exact = np.percentile(seconds, percent, method="inverted_cdf")
    if exact < LONGEST:
        assert exact - 1e-9 <= times.percentile(percent) <= exact + RESOLUTION + 1e-9
    else:
        assert times.percentile(percent) == max(seconds)
    assert times.count == len(seconds) and times.longest == max(seconds)
    assert times.rate == pytest.approx(len(seconds) / sum(seconds))
