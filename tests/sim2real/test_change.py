"""What changed between two recordings of an arm of which no nominal model is right."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from arm_generator import Truth, at, record
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real.arm import rigid_body as rigid
from sim2real.arm.model import panda
from sim2real.arm.nominal_prediction import make_drive
from sim2real.cli.diagnose import parse
from sim2real.diagnosis import explain_gap
from sim2real.effects.recurrences import bristle_deflection, bristle_state
from sim2real.effects.stage import Stage
from sim2real.effects.torque_loop import torque_saturation
from sim2real.effects.transmission import backlash
from sim2real.inference import nuisances
from sim2real.inference.context import find_packets_lost_since, make_context
from sim2real.inference.loop_delay import estimate_loop_delay
from sim2real.inference.projection import orthonormal_basis, project_out
from sim2real.inference.regression import make_regression
from sim2real.inference.residual_stages import ResidualStages
from sim2real.report.document import make_report, to_json
from sim2real.simulation.patch_trial import make_patch

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
    return explain_gap([after], reference=[before]), after


@pytest.mark.slow
def test_what_was_there_before_is_no_change(before):
    diagnosis, log = since(before)
    assert diagnosis.verdict == "no_gap" and not [f for f in diagnosis.findings if f.is_chosen]
    report = make_report(diagnosis, [log], 0.0)
    assert report["data"]["reference"] == ["old"] and report["data"]["bags"] == ["new"] and to_json(report)


@pytest.mark.slow
def test_a_payload_that_was_put_on_is_found_in_an_arm_that_is_wrong_in_every_joint(before):
    diagnosis, _ = since(before, payload=0.3)
    assert diagnosis.verdict == "identified"
    (entry,) = make_patch(diagnosis).effects
    assert entry.effect == "payload"
    assert entry.parameters["mass"] == pytest.approx(0.3 * 1.05, abs=0.01)  # 5 % heavier like all that the arm is


def with_torque(log, joint, extra):
    """The log with more torque (n,) Nm asked for, and given, at a joint."""
    torque, asked, target = log.torque.copy(), log.commands.torque.copy(), log.commands.target.copy()
    torque[:, joint] += extra
    asked[:, joint] += (ahead := np.append(extra[1:], extra[-1]))
    target[:, joint] += ahead / log.commands.stiffness[:, joint]
    return replace(log, torque=torque, commands=replace(log.commands, torque=asked, target=target))


@pytest.mark.slow
def test_uneven_friction_that_bends_its_bristles_further_is_one_effect(before):
    """It was an offset of the drive with presliding friction: the old bristles carry more, and all of it turns over late."""
    joint, reach, (forward, backward) = 2, 4e-3, (0.7, -0.05)
    after = record(WRONG, name="new", noise=99)
    turned, own = (
        bristle_deflection(after.position[:, joint], reach),
        bristle_deflection(after.position[:, joint], WRONG.breakaway),
    )
    extra = forward * (turned + 1) / 2 + backward * (turned - 1) / 2 + panda().frictionloss[joint] * (turned - own)
    diagnosis = explain_gap([with_torque(after, joint, extra)], reference=[before])
    (found,) = [f for f in diagnosis.findings if f.is_chosen]
    assert (found.effect.id, found.component) == ("asymmetric_coulomb_friction", panda().joints[joint])
    assert found.parameters["level_positive"].value == pytest.approx(forward, abs=0.02)
    assert found.parameters["level_negative"].value == pytest.approx(backward, abs=0.02)
    assert found.parameters["reach"].value == pytest.approx(reach, rel=0.15)
    assert make_patch(diagnosis).effects


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
    held, more, error, set_aside = find_packets_lost_since(d, 1)
    assert abs(more) < 5 * error + 1e-5
    if more <= 3 * error:  # a chance of one in seven hundred that it is more
        assert not held.any() and set_aside.mean() == pytest.approx(share, abs=0.01)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.02]))
def test_more_lost_packets_are_those_of_the_later_recording(seed, before):
    d = commands_that_wander(np.random.default_rng(seed), (before, before + 0.04))
    held, more, error, set_aside = find_packets_lost_since(d, 1)
    assert more == pytest.approx(0.04, abs=5 * error)
    now = d.trajectory == 1
    assert held[now].any() and not held[~now].any() and not set_aside[now].any()


def test_no_delay_is_usual_between_two_recordings(before):
    one, two = make_context([before], panda()), context_of(before, before)
    for stage in (Stage.DRIVE, Stage.DYNAMICS):
        (usual, *_), (change, *_) = (nuisances.nuisance_parameters(c, stage, 0) for c in (one, two))
        assert usual.name == change.name and usual.upper > 1e-3
        assert change.centre == 0.0 and change.upper <= 3e-4 and change.lower == -change.upper
    design = make_regression(two)
    assert estimate_loop_delay(design) is design


def test_what_any_arm_has_is_on_both_days_alike(before):
    """Its links are the same, and it creeps as much: a share of friction that turns over late is new only where it is more."""
    one, two = make_context([before], panda()), context_of(before, before)
    for joint in range(7):
        usual, change = (nuisances.nuisance_parameters(c, Stage.DYNAMICS, joint) for c in (one, two))
        shown = nuisances.nuisance_columns(two, Stage.DYNAMICS, joint)
        assert len(change) == shown.shape[1] == len(usual) - one.prediction.link_errors[joint].shape[1]
        assert (np.abs(shown).max(axis=0) > 0).all()
        assert all(p.centre == 0.0 and p.lower == -p.upper for p in change)


def test_a_day_of_the_drive_alone_is_what_it_was_of_both(before):
    d = context_of(before, before).drive
    for day in (0, 1):
        alone = d.only(d.trajectory == day)
        assert (alone.trajectory == day).all() and alone.starts.tolist() == [0] and alone.period == d.period
        assert np.array_equal(alone.measured, d.measured[d.trajectory == day])
    assert d.only(np.ones(len(d.time), bool)) is d


def test_the_delay_that_a_loop_had_is_that_of_the_reference(before):
    after = record(WRONG, name="new", noise=99)
    torque = after.torque.copy()
    torque[1:] -= 0.4 * np.diff(after.torque, axis=0)
    late = make_drive([before, replace(after, torque=torque)], panda(), 1).late
    assert late == pytest.approx(make_drive([before], panda()).late)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_what_recordings_have_in_common_is_taken_out_and_what_one_has_alone_stays(seed):
    rng = np.random.default_rng(seed)
    common, rows = rng.normal(size=(400, 6)), np.ones(400, bool)
    later = np.repeat([0, 1], 200) == 1
    new = common[:, :1] * later[:, None]
    left = project_out(orthonormal_basis(common, rows), rows, np.column_stack([common @ rng.normal(size=6), new[:, 0]]))
    assert np.abs(left[:, 0]).max() < 1e-9
    assert 0.3 < left[:, 1] @ left[:, 1] / (new[:, 0] @ new[:, 0]) < 0.7  # the half of which the reference tells
    assert np.array_equal(project_out(orthonormal_basis(np.zeros((400, 2)), rows), rows, new), new)


def test_days_begin_anew_and_recordings_of_one_day_follow_each_other(before):
    c = make_context([before, before, before, before], panda(), 2)
    assert c.begins == pytest.approx([0.0, before.duration, 0.0, before.duration])
    assert c.is_later(np.array([0, 1, 2, 3])).tolist() == [False, False, True, True]
    assert make_context([before, before], panda()).begins == pytest.approx([0.0, before.duration])


def test_friction_that_falls_alike_on_both_days_is_the_same_column_on_both(before):
    c = make_context([before, before], panda(), 1)
    effects = [e for e in ResidualStages(c).regressors if e.id == "thermal_drift"]
    now = c.is_later(c.samples.trajectory)
    assert effects
    for effect in effects:
        (column,) = effect.columns[Stage.DYNAMICS](c, 3).T
        assert column[now] == pytest.approx(column[~now]) and np.ptp(column) > 0


def with_motor(log, joint, twist, seed):
    """The log with a motor's encoder beside the links', which a joint's gear leads by `twist`(load (n,) Nm) (n,) rad."""
    motor = log.position + 1e-5 * np.random.default_rng(seed).normal(size=log.position.shape)
    bare = make_context([replace(log, motor=motor)], panda())
    motor[:, joint] += twist(np.interp(log.time, bare.samples.time, bare.transmission.load[:, joint]))
    return replace(log, motor=motor)


def test_hysteresis_that_a_gear_always_had_is_no_change(before):
    def wound(load):
        return 1e-4 * load + 1e-4 * bristle_state(np.diff(1e-4 * load, prepend=1e-4 * load[:1]), 2e-4)

    c = context_of(*(with_motor(before, 3, wound, seed) for seed in (1, 2)))
    stages, nothing = ResidualStages(c), np.zeros((len(c.samples.time), 0))
    rows, twist = stages.rows(Stage.TRANSMISSION, 3), stages.residual(Stage.TRANSMISSION, 3)
    _, left = stages.project_out_reference(Stage.TRANSMISSION, 3, rows, nothing, twist)
    straight = project_out(
        orthonormal_basis(nuisances.nuisance_columns(c, Stage.TRANSMISSION, 3), rows), rows, twist[:, None]
    )
    assert np.std(left[rows]) < 0.3 * np.std(straight[rows])


def test_a_limit_that_a_drive_always_had_is_no_change(before):
    """It lies between two limits that are tried; what it takes is gone from either stage, and not only from r1."""
    joint, stages_of = 3, (Stage.DRIVE, Stage.DYNAMICS)
    given_ = make_drive([before], panda())
    limit = 0.817 * np.abs(given_.commanded + given_.gravity)[:, joint].max()
    held = rigid.gravity_torque(panda(), before.position)[:, joint]

    def limited(log):
        torque = log.torque.copy()
        torque[:, joint] = np.clip(torque[:, joint] + held, -limit, limit) - held
        return replace(log, torque=torque)

    logs = limited(before), limited(record(WRONG, name="new", noise=99))
    stages, whole = ResidualStages(context_of(*logs)), ResidualStages(make_context(list(logs), panda()))
    shown = torque_saturation._regressor(limit, joint, False)
    for stage in stages_of:
        rows, said = stages.rows(stage, joint), whole.columns(shown, stage, joint)
        _, left = stages.project_out_reference(stage, joint, rows, said[:, :0], said[:, 0])
        assert np.std(said[rows]) > 0.05 and np.std(left[rows]) < 0.05 * np.std(said[rows])


def test_a_play_that_is_new_is_read_off_the_later_recording(before):
    """A gear without play is nowhere in particular: asked of both days alike, its twist would not follow its load."""
    joint, half = 0, 2e-4  # a joint whose load changes its sign
    old = with_motor(before, joint, np.zeros_like, 1)
    new = with_motor(before, joint, lambda load: half * np.sign(load), 2)
    c = context_of(old, new)
    assert backlash._twist_range(c, joint)[1] == pytest.approx(half, rel=0.1)
    assert backlash._follows_load(c, joint)
    # What both recordings have in common must not be nought in the earlier one: it would be the change.
    earlier = ~c.is_later(c.transmission.trajectory)
    side = backlash._twist_side(c, joint, 0.5)
    assert np.abs(side[earlier]).mean() > 0.5 and np.abs(side[~earlier]).mean() > 0.5


def test_the_command_takes_recordings_of_the_arm_as_it_was():
    options = parse(["a", "b", "--reference", "c", "d", "--out", "r"])
    assert [p.name for p in options.logs] == ["a", "b"] and [p.name for p in options.reference] == ["c", "d"]
