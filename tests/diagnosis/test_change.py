"""What changed between two recordings of an arm of which no nominal model is right."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from arm_generator import Truth, at, record
from hypothesis import given, settings
from hypothesis import strategies as st

from np_diagnosis.commands.diagnose import parse
from np_diagnosis.diagnosis import diagnose
from np_diagnosis.inference.change import apart, is_later
from np_diagnosis.report.document import make_report, to_json
from np_diagnosis.simulation.patching import make_patch

# Against the nominal arm: friction, damping, an offset, what no catalogue knows, and every link 5 % heavier.
WRONG = Truth(
    coulomb_positive=at(1, 0.3),
    viscous=at(3, 0.4) + at(5, 0.1),
    offset=at(2, 0.8),
    waviness=at(4, 0.5),
    mass_error=0.05,
)


@pytest.fixture(scope="module")
def before():
    return record(WRONG, name="old")


def since(before, **changes):
    after = record(replace(WRONG, **changes), name="new", noise=99)
    return diagnose([after], reference=[before]), after


def test_what_was_there_before_is_no_change(before):
    diagnosis, log = since(before)
    assert diagnosis.verdict == "no_gap" and not [f for f in diagnosis.findings if f.is_chosen]
    report = make_report(diagnosis, [log], 0.0)
    assert report["data"]["reference"] == ["old"] and report["data"]["bags"] == ["new"] and to_json(report)


def test_a_payload_that_was_put_on_is_found_in_an_arm_that_is_wrong_in_every_joint(before):
    diagnosis, _ = since(before, payload=0.3)
    assert diagnosis.verdict == "identified"
    (entry,) = make_patch(diagnosis).effects
    assert entry.effect == "payload"
    assert entry.parameters["mass"] == pytest.approx(0.3 * 1.05, abs=0.01)  # 5 % heavier like all that the arm is


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_what_recordings_have_in_common_is_taken_out_and_what_one_has_alone_stays(seed):
    rng = np.random.default_rng(seed)
    common, rows = rng.normal(size=(400, 6)), np.ones(400, bool)
    later = is_later(SimpleNamespace(reference=1), np.repeat([0, 1], 200))
    new = common[:, :1] * later[:, None]
    left = apart(common, rows, np.column_stack([common @ rng.normal(size=6), new[:, 0]]))
    assert np.abs(left[:, 0]).max() < 1e-9
    assert 0.3 < left[:, 1] @ left[:, 1] / (new[:, 0] @ new[:, 0]) < 0.7  # the half of which the reference tells
    assert np.array_equal(apart(np.zeros((400, 2)), rows, new), new)


def test_the_command_takes_recordings_of_the_arm_as_it_was():
    options = parse(["a", "b", "--reference", "c", "d", "--out", "r"])
    assert [p.name for p in options.logs] == ["a", "b"] and [p.name for p in options.reference] == ["c", "d"]
