"""Sets of changes: one arm on two days."""

import json
import shlex
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from np_blind.arm import generate
from np_blind.arm import set as blind
from np_blind.arm.evaluation.scoring import score_case, summary
from np_blind.arm.evaluation.tables import GOALS_OF_CHANGES, figures_table
from np_blind.arm.plant.physics import nominal_physics
from np_blind.arm.sampling.background import DAY_DELAY, DAY_FRICTION
from np_blind.arm.sampling.cases import ArmCase, baseline_case, draw_cases, make_physics
from np_blind.arm.sampling.faults import EFFECTS, HELD, PEAK_TOTAL, SPARE, Fault, apply, largest, visible, widen
from np_blind.arm.sampling.key import make_key
from np_record.bag import Recording

WHICH = "development_changes"


def both_days(faults=(), always=(), number=0):
    """(first day, second day, what changed) of one arm."""
    case = ArmCase(number, "single" if faults else "null", tuple(faults), (3, 600, 2, number), tuple(always), 2)
    after, (truth,) = make_physics([case])
    return make_physics([baseline_case(case)])[0], after, truth


def test_a_third_has_no_change_and_the_others_have_all_effects_in_turn():
    cases = draw_cases(60, 600, WHICH)
    changes = [case.faults[0] for case in cases if case.faults]
    assert [case.kind for case in cases].count("null") == 20 == 60 - len(changes)
    assert {f.effect for f in changes} == set(EFFECTS)
    assert all(0.8 <= f.size <= visible(f.effect).largest for f in changes)
    assert {len(case.always) for case in cases} == {0, 1, 2, 3}
    for case in cases:
        assert len({f.effect for f in (*case.faults, *case.always)}) == len(case.faults) + len(case.always)
        assert all(0.8 <= f.size <= 5.0 for f in case.always)
    assert draw_cases(60, 600, WHICH) == cases != draw_cases(60, 600, "locked_changes")


@pytest.mark.parametrize("which", ["development", WHICH])
def test_effects_come_in_every_joint_where_they_show_and_sizes_begin_below_the_limit(which):
    faults = [f for k in range(12) for case in draw_cases(200, 600 + k, which) for f in case.faults]
    for effect in EFFECTS:
        joints = {f.joint + 1 for f in faults if f.effect == effect and f.joint is not None}
        shown = (
            {1, 6, 7} if effect == "torque_saturation" else set(visible(effect).joints)
        )  # others are too near to their weight
        assert joints == shown, effect
    assert {f.joint for f in faults} >= set(range(7))
    sizes = np.array([f.size for f in faults if f.effect in EFFECTS])
    assert 0.8 <= sizes.min() < 0.81 and 9.5 < sizes.max() <= 10.0


@pytest.mark.parametrize("which", ["development", WHICH])
def test_a_drive_that_is_cut_holds_its_arm_up_and_shows_it(which):
    """Joints 1, 6 and 7: the suite's torque on the others is too near to their weight."""
    cases = [case for k in range(12) for case in draw_cases(200, 900 + k, which)]
    cut = [f for case in cases for f in (*case.faults, *case.always) if f.effect == "torque_saturation"]
    assert {f.joint + 1 for f in cut} == {1, 6, 7}
    physics, rng = nominal_physics(len(cut)), np.random.default_rng(0)
    for arm, fault in enumerate(cut):
        given = widen(physics, arm, fault, apply(physics, arm, fault, rng), rng)["limit"][0]
        assert SPARE * HELD[fault.joint] <= given * (1 + 1e-9)
        assert given == pytest.approx(PEAK_TOTAL[fault.joint] * (1 - 0.07 * fault.size))  # as large as the key has it
    assert max(f.size for f in cut if f.joint == 5) < largest("torque_saturation", 5) < 3.0
    assert largest("torque_saturation", 0) == 6.0


def test_an_arm_is_the_same_on_both_days_but_for_what_a_day_brings():
    always = Fault("torque_offset", 3, 4.0), Fault("payload", None, 3.0)
    first, second, truth = both_days(always=always)
    assert truth == [] and not np.array_equal(first.offset, np.zeros((1, 7)))
    for name in ("offset", "breakaway", "uneven", "holding", "encoder_bias", "armature"):
        assert np.array_equal(getattr(first, name), getattr(second, name)), name
    assert np.array_equal(first.inertials.com, second.inertials.com)
    for name in ("coulomb_forward", "viscous_backward"):
        share = getattr(second, name) / getattr(first, name) - 1
        assert 0 < np.abs(share).min() and np.abs(share).max() <= DAY_FRICTION
    assert 0 < abs(second.command_delay[0] - first.command_delay[0]) <= DAY_DELAY
    assert second.noise[0] != first.noise[0]


def test_the_truth_of_a_change_is_against_the_arm_as_it_was():
    heavy = Fault("payload", None, 5.0)
    first, second, (given,) = both_days([Fault("link_inertia", 6, 4.0)], [heavy])
    turned = [np.trace(p.inertials.inertia[0, 6]) for p in (first, second)]
    nominal = np.trace(make_physics([ArmCase(0, "null", (), (3, 600, 2, 0))], False)[0].inertials.inertia[0, 6])
    assert given["scale"][0] == pytest.approx((turned[1] - turned[0]) / nominal)
    first, second, (given,) = both_days([Fault("command_delay", None, 3.0)])
    assert given["delay"][0] == pytest.approx(second.command_delay[0] - first.command_delay[0])
    assert abs(given["delay"][0] - 1.5e-3) <= DAY_DELAY
    first, second, (given,) = both_days([Fault("asymmetric_coulomb_friction", 2, 3.0)])
    for name, array in (("level_positive", "coulomb_forward"), ("level_negative", "coulomb_backward")):
        assert given[name][0] == pytest.approx((getattr(second, array) - getattr(first, array))[0, 2])
    first, second, (given,) = both_days([Fault("torque_saturation", 3, 3.0)])
    assert given["limit"][0] == second.saturation[0, 3] < first.saturation[0, 3]


def test_a_key_says_what_an_arm_always_had_and_scores_are_of_the_change():
    entries = json.loads(make_key(30, 600, WHICH))["cases"]
    assert all("always" in entry for entry in entries) and any(entry["always"] for entry in entries)
    assert "always" not in json.loads(make_key(2, 600, "development"))["cases"][0]
    entry = next(e for e in entries if e["kind"] == "single" and e["faults"][0]["size"] < 3 and e["always"])

    def score(fault):
        added = [{"effect": fault["effect"], "component": fault["component"], "probability": 1.0, "parameters": {}}]
        return score_case(entry, {"verdict": "identified", "effects": added, "where": []})

    assert score(entry["faults"][0]).effect_any is True and score(entry["faults"][0]).effect is None
    assert score(entry["always"][0]).effect_any is False
    scores = [score(entry["faults"][0])]
    table = figures_table({**summary(scores), "set": WHICH}, scores)
    assert all(text in table for _, text, _ in GOALS_OF_CHANGES) and "held-out" not in table


def test_the_diagnosis_is_shown_both_days(tmp_path, monkeypatch):
    monkeypatch.setattr(blind, "workers", ThreadPoolExecutor)
    diagnosis = (
        "import json, pathlib, sys; new, option, old, _, out = sys.argv[1:]; out = pathlib.Path(out); "
        "assert option == '--reference' and new != old; "
        "assert all((pathlib.Path(bag) / 'metadata.yaml').exists() for bag in (new, old)); "
        "(out / 'report.json').write_text(json.dumps({'verdict': 'no_gap', 'effects': [], 'where': []})); "
        "(out / 'patch.yaml').write_text('effects: []')"
    )
    command = ["--cases", "2", "--seed", str(600), "--set", WHICH, "--only", "sinusoid_7", "--keep"]
    command += ["--out", str(tmp_path), "--diagnosis", shlex.join([sys.executable, "-c", diagnosis])]
    assert blind.main(command) == 0
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["figures"]["errors"] == 0 and results["figures"]["false_alarm"] == 0.0
    assert results["figures"]["harm_n"] == 0 and (tmp_path / "results.svg").exists()
    shown = []
    for path in (generate.reference_path(tmp_path, 0), generate.bag_path(tmp_path, 0)):
        with Recording(path, ["joint_states"]) as recording:
            states = [message.decode() for message in recording.messages("joint_states")]
        shown.append((states[0].header.stamp.sec, np.array([state.position[:7] for state in states])))
    (before, old), (after, new) = shown
    assert after - before == 86_400 and old.shape == new.shape
    assert 1e-6 < np.abs(new - old).max() < 0.05  # noise of its own, and whatever changed
    with pytest.raises(SystemExit):
        blind.parse([*command, "--baselines"])
