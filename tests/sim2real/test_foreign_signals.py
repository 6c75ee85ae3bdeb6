"""Signals held against each other: rows that repeat, speeds that lag, joints that move and are not named, gains not yet said."""

from dataclasses import replace

import numpy as np
import pytest
import six_hinges
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real.arm.files import load_arm
from sim2real.recordings.fresh_rows import find_fresh_rows
from sim2real.recordings.reading import ContractViolation, load_log
from sim2real.recordings.signals import Commands, Log
from sim2real.recordings.speed_lag import correct_speed, estimate_speed_lag

from np_record.bag_writer import BagWriter
from np_record.bulk import serialize_joint_states
from np_record.topics import TIMELINE

JOINTS = tuple(f"j{number}" for number in range(6))


def moving(lag: float = 0.0, rate: int = 200) -> Log:
    """A log of six joints whose speeds are those of `lag` s before."""
    time = np.arange(8 * rate) / rate
    position = six_hinges.motion(time, 0)[0]
    velocity = six_hinges.motion(time - lag, 0)[1]
    return Log("log", time, position, velocity, np.zeros_like(position), time, True)


@settings(deadline=None, max_examples=10)
@given(st.floats(-0.03, 0.03))
def test_the_lag_of_a_speed_is_found(lag):
    np.testing.assert_allclose(estimate_speed_lag(moving(lag)), lag, atol=0.002)


def test_a_speed_that_lags_is_replaced_or_refused():
    log, late = moving(), moving(0.03)
    assert correct_speed(log, JOINTS) is log
    found = correct_speed(late, JOINTS)
    assert np.abs(found.velocity - log.velocity)[2:-2].max() < 0.01 * np.abs(log.velocity).max()
    assert found.speed_lag == pytest.approx(0.03, abs=0.003)
    nothing = np.zeros((0, 6))
    commands = Commands(np.zeros(0, int), nothing, nothing, nothing, np.zeros(0), nothing, nothing)
    for wrong, text in (
        (replace(late, commands=commands), "lags behind its position by 30 ms"),
        (moving(-0.03), "is ahead of"),
    ):
        with pytest.raises(ContractViolation, match=text):
            correct_speed(wrong, JOINTS)


def test_rows_repeat_where_nothing_changes_although_a_joint_moves():
    log = moving()
    held = np.repeat(np.arange(len(log.time)), 4)
    fresh = find_fresh_rows(log.position[held], log.velocity[held])
    np.testing.assert_array_equal(np.flatnonzero(fresh), 4 * np.arange(len(log.time)))
    still = np.zeros((50, 6))
    assert find_fresh_rows(still, still).all()


def test_a_joint_that_is_not_named_must_stay_where_the_model_holds_it(tmp_path):
    arm = load_arm(six_hinges.MJCF)
    time = np.arange(400) / 200
    position, velocity, _ = six_hinges.motion(time, 0)
    named = arm.joints[:3]
    for name, away in (("moves", 1.0), ("still", 0.0)):
        position[:, 3:] *= away
        writer = BagWriter(tmp_path / name, {}, [TIMELINE])
        stamps = (time * 1e9).astype(np.int64)
        for stamp, data in zip(stamps, serialize_joint_states(stamps, arm.joints, position, velocity, 0 * position)):
            writer.write(int(stamp), TIMELINE, data)
        writer.close()
    part = load_arm(six_hinges.MJCF, named)
    assert [joint.name for joint in part.held] == list(arm.joints[3:]) and not arm.held
    with pytest.raises(ContractViolation, match=f"expected joints that are not named to stay.*{arm.joints[3]}"):
        load_log(tmp_path / "moves", part)
    assert load_log(tmp_path / "still", part).position.shape == (400, 3)
