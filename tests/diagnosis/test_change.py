"""What changed between two recordings of an arm of which no nominal model is right."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from arm_generator import Truth, at, record
from hypothesis import given, settings
from hypothesis import strategies as st

from np_diagnosis.arm.model import panda
from np_diagnosis.arm.stages import drive
from np_diagnosis.commands.diagnose import parse
from np_diagnosis.diagnosis import diagnose
from np_diagnosis.inference import nuisances
from np_diagnosis.inference.change import apart, directions, is_later
from np_diagnosis.inference.context import lost_since, make_context
from np_diagnosis.inference.design import make_design
from np_diagnosis.inference.loop_delay import settle_delay
from np_diagnosis.report.document import make_report, to_json
from np_diagnosis.simulation.patching import make_patch
from np_effects.stage import Stage

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


def in_steps(log, joint, step):
    """The log with an encoder that reads in steps (rad)."""
    position = log.position.copy()
    position[:, joint] = np.round(position[:, joint] / step) * step
    return replace(log, position=position)


def context_of(*logs):
    return make_context(list(logs), panda(), 1)


def test_an_encoder_that_always_read_in_steps_is_no_change(before):
    after = record(WRONG, name="new", noise=99)
    always = context_of(in_steps(before, 2, 1e-4), in_steps(after, 2, 1e-4))
    assert not always.quanta.any()
    coarser = context_of(in_steps(before, 2, 1e-4), in_steps(after, 2, 2e-4))
    assert coarser.quanta == pytest.approx(at(3, 2e-4), rel=0.01)
    assert context_of(before, in_steps(after, 4, 1e-4)).quanta == pytest.approx(at(5, 1e-4), rel=0.01)


def commands_that_wander(rng, shares, noise=0.02):
    """A drive of two recordings (6000 periods each) that each lose a share of their commands."""
    commanded = np.cumsum(rng.normal(size=(12000, 2)), axis=0)
    trajectory = np.repeat([0, 1], 6000)
    lost = rng.random(12000) < np.array(shares)[trajectory]
    lost[[0, 6000]] = False
    held = commanded[np.maximum.accumulate(np.where(lost, 0, np.arange(12000)))]
    return SimpleNamespace(
        commanded=commanded,
        arrived=commanded,
        measured=held + noise * rng.normal(size=(12000, 2)),
        starts=np.array([0, 6000]),
        period=0.002,
        late=0.0,
        trajectory=trajectory,
    )


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.02, 0.05]))
def test_packets_that_always_were_lost_are_no_change(seed, share):
    d = commands_that_wander(np.random.default_rng(seed), (share, share))
    held, more, error, set_aside = lost_since(d, 1)
    assert abs(more) < 5 * error + 1e-5
    if more <= 3 * error:  # a chance of one in seven hundred that it is more
        assert not held.any() and set_aside.mean() == pytest.approx(share, abs=0.01)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.02]))
def test_more_lost_packets_are_those_of_the_later_recording(seed, before):
    d = commands_that_wander(np.random.default_rng(seed), (before, before + 0.04))
    held, more, error, set_aside = lost_since(d, 1)
    assert more == pytest.approx(0.04, abs=5 * error)
    now = d.trajectory == 1
    assert held[now].any() and not held[~now].any() and not set_aside[now].any()


def test_no_delay_is_usual_between_two_recordings(before):
    one, two = make_context([before], panda()), context_of(before, before)
    for stage in (Stage.DRIVE, Stage.DYNAMICS):
        (usual, *_), (change, *_) = (nuisances.parameters(c, stage, 0) for c in (one, two))
        assert usual.name == change.name and usual.upper > 1e-3
        assert change.centre == 0.0 and change.upper <= 3e-4 and change.lower == -change.upper
    design = make_design(two)
    assert settle_delay(design) is design


def test_the_delay_that_a_loop_had_is_that_of_the_reference(before):
    after = record(WRONG, name="new", noise=99)
    torque = after.torque.copy()
    torque[1:] -= 0.4 * np.diff(after.torque, axis=0)
    late = drive([before, replace(after, torque=torque)], panda(), 1).late
    assert late == pytest.approx(drive([before], panda()).late)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_what_recordings_have_in_common_is_taken_out_and_what_one_has_alone_stays(seed):
    rng = np.random.default_rng(seed)
    common, rows = rng.normal(size=(400, 6)), np.ones(400, bool)
    later = is_later(SimpleNamespace(reference=1), np.repeat([0, 1], 200))
    new = common[:, :1] * later[:, None]
    left = apart(directions(common, rows), rows, np.column_stack([common @ rng.normal(size=6), new[:, 0]]))
    assert np.abs(left[:, 0]).max() < 1e-9
    assert 0.3 < left[:, 1] @ left[:, 1] / (new[:, 0] @ new[:, 0]) < 0.7  # the half of which the reference tells
    assert np.array_equal(apart(directions(np.zeros((400, 2)), rows), rows, new), new)


def test_the_command_takes_recordings_of_the_arm_as_it_was():
    options = parse(["a", "b", "--reference", "c", "d", "--out", "r"])
    assert [p.name for p in options.logs] == ["a", "b"] and [p.name for p in options.reference] == ["c", "d"]
