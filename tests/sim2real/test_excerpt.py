"""A quick look at parts of a recording: rows of it, unchanged, and the same answer where it is plain."""

import numpy as np
import pytest
from arm_generator import Truth, record
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real.diagnosis import explain_gap
from sim2real.recordings.excerpt import cut_excerpts
from sim2real.thresholds import THRESHOLDS


def at(joint, value):
    array = np.zeros(7)
    array[joint - 1] = value
    return array


@pytest.fixture(scope="module")
def log():
    return record(Truth(coulomb_positive=at(4, 0.4), coulomb_negative=at(4, 0.4)), duration=70.0)


@settings(max_examples=20)
@given(st.floats(12.0, 60.0))
def test_stretches_are_rows_of_the_recording(log, most):
    parts = cut_excerpts([log], most)
    assert sum(part.duration for part in parts) < most + THRESHOLDS.recordings.stretch
    for part in parts:
        assert part.time[0] == 0.0 and part.duration == pytest.approx(THRESHOLDS.recordings.stretch, abs=0.01)
        first = int(np.flatnonzero((log.position == part.position[0]).all(axis=1))[0])
        rows = slice(first, first + len(part.time))
        assert np.array_equal(part.torque, log.torque[rows]) and np.allclose(
            part.time, log.time[rows] - log.time[first]
        )
        assert np.allclose(part.torque_time - part.time, log.torque_time[rows] - log.time[rows])
        c, whole = part.commands, log.commands
        assert np.array_equal(c.rows, np.arange(len(part.time)))
        assert np.array_equal(c.torque, whole.torque[rows]) and np.allclose(c.torque_time - part.time[c.rows], 0.001)


def test_a_short_recording_is_looked_at_whole(log):
    assert cut_excerpts([log], 100.0) == [log]


def test_the_quick_look_finds_what_is_plain(log):
    quick = explain_gap(cut_excerpts([log], 36.0), quick=True)
    (found,) = [f for f in quick.findings if f.is_chosen]
    assert (found.effect.id, found.component) == ("coulomb_friction", "panda_joint4")
    level = found.parameters["level"]
    assert level.low < 0.4 < level.high


def test_a_quick_look_at_two_effects_does_not_call_them_unknown():
    """It tries one effect at a time: the joint that is left may well have a known one."""
    two = record(Truth(coulomb_positive=at(4, 0.4), coulomb_negative=at(4, 0.4), viscous=at(2, 0.5)), duration=45.0)
    quick = explain_gap([two], quick=True)
    assert quick.unexplained and "known effect" not in quick.sentence
    assert "no single effect explains: without --quick sets of effects are tried" in quick.sentence
