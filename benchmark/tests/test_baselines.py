"""Baselines inside the blind test: read generously, judged by the same rules, printed beside the diagnosis."""

import json
import shlex
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest
from sim2real.effects.patch import Patch, PatchEffect, dump_patch

from np_blind.arm.evaluation import baselines as others
from np_blind.arm.evaluation.scoring import score_case, summary
from np_blind.arm.evaluation.tables import figures_table
from np_blind.arm.sampling.cases import draw_cases, make_physics
from np_blind.arm.sampling.key import make_key
from np_blind.repository import ROOT
from np_description.panda import JOINT_NAMES

FAKE = (
    "import pathlib, sys; out = pathlib.Path(sys.argv[-1]); "
    "[((out / n).mkdir(parents=True), (out / n / 'patch.yaml').write_text('effects: []')) "
    "for n in ('none', 'paper', 'sysid_3', 'sysid_6')]; "
    'print(\'{"none": {"wall_s": 0.5}, "paper": {"wall_s": 7.0}}\')'
)


def entry(effect, component, **values):
    return {"effect": effect, "component": component, "parameters": values}


def test_what_is_changed_beyond_its_limit_is_named_largest_first():
    report = others.as_report(
        [
            entry("coulomb_friction", "panda_joint2", level=0.12),  # twice the limit of 0.06
            entry("armature", "panda_joint7", inertia=-0.08),  # ten times
            entry("viscous_friction", "panda_joint1", coefficient=0.01),  # an eighth
            entry("link_com", "panda_joint4", moment_x=0.03, moment_y=0.04, moment_z=0.0),  # five times
        ]
    )
    assert [(e["effect"], e["component"]) for e in report["effects"]] == [
        ("armature", "panda_joint7"),
        ("link_com", "panda_joint4"),
        ("coulomb_friction", "panda_joint2"),
    ]
    assert report["where"][0] == {"module": "joint_dynamics", "component": "panda_joint7"}
    assert report["verdict"] == "identified" and others.as_report([])["verdict"] == "no_gap"


def test_the_truth_as_a_patch_is_right():
    case = next(
        c
        for c in draw_cases(40, 0, "development")
        if c.kind == "single"
        and c.faults[0].size > 3
        and c.faults[0].effect in ("armature", "coulomb_friction", "viscous_friction")
    )
    fault, ((truth,),) = case.faults[0], make_physics([case])[1]
    patch = [entry(fault.effect, fault.component, **{name: value for name, (value, _) in truth.items()})]
    known = {
        "case": 0,
        "kind": "single",
        "faults": [{"effect": fault.effect, "component": fault.component, "size": fault.size, "parameters": {}}],
    }
    score = score_case(known, others.as_report(patch))
    assert score.module and score.joint and score.effect and not score.covered


def run(tmp_path, command):
    (tmp_path / "bag").mkdir()
    others.identify(tmp_path / "bag", tmp_path / "report", command, 60.0)
    return tmp_path / "report" / "baselines"


def test_a_command_that_fails_leaves_the_reason(tmp_path):
    out = run(tmp_path, f"{sys.executable} -c 'import sys; sys.exit(\"no such joint\")'")
    assert "no such joint" in (out / "error.txt").read_text() and not (out / "fits.json").exists()


def test_a_reason_names_files_by_their_place_in_the_repository(tmp_path):
    out = run(tmp_path, f"{sys.executable} {ROOT}/tests/nobody.py")
    assert "can't open file 'tests/nobody.py'" in (out / "error.txt").read_text()


def test_a_command_that_takes_too_long_is_ended(tmp_path):
    others.identify(
        tmp_path,
        tmp_path / "report",
        f"{sys.executable} -c 'import threading; threading.Event().wait()'",
        0.5,
    )
    assert "no answer within 0.5 s" in (tmp_path / "report" / "baselines" / "error.txt").read_text()


@pytest.mark.slow
def test_figures_have_the_diagnosis_keys_and_stand_beside_them(tmp_path):
    count = 3
    key, cases = json.loads(make_key(count, 1, "development")), draw_cases(count, 1, "development")
    folders = [tmp_path / f"case_{k}" for k in range(count)]
    for folder in folders:
        others.identify(tmp_path, folder, f"{shlex.quote(sys.executable)} -c {shlex.quote(FAKE)}", 60.0)
        assert (folder / "baselines" / "error.txt").read_text() == ""
    # One baseline fails in one case, and prints something in another.
    (folders[0] / "baselines" / "paper" / "patch.yaml").write_text("nothing")
    patch = Patch((PatchEffect("armature", JOINT_NAMES[2], {"inertia": 0.2}),))
    (folders[1] / "baselines" / "paper" / "patch.yaml").write_text(dump_patch(patch))
    with ThreadPoolExecutor(1) as pool:
        beside = others.score_baselines(key["cases"], cases, folders, [cases], pool)
    assert set(beside) == {*others.NAMES, "wall_s_a_case"} and beside["paper"]["wall_s_a_case"] == 7.0
    assert beside["paper"]["errors"] == 1 and beside["none"]["errors"] == 0
    assert set(others.KEYS) < set(beside["none"]) and beside["none"]["harm"] == 0.0
    scores = [score_case(e, {"verdict": "no_gap", "effects": [], "where": []}) for e in key["cases"]]
    figures = {**summary(scores), "baselines": beside}
    assert json.loads(json.dumps(figures)) == figures
    table = figures_table(figures, scores)
    assert "| figure | diagnosis | none | paper | sysid_3 | sysid_6 |" in table and "s a case" in table
    assert "diagnosis |" not in figures_table(summary(scores), scores)


def test_cases_that_were_run_without_baselines_are_named(tmp_path):
    cases, folders = draw_cases(2, 0, "development"), [tmp_path / "case_000", tmp_path / "case_001"]
    entries = json.loads(make_key(2, 0, "development"))["cases"]
    with pytest.raises(ValueError, match="case_000, case_001 were not; name another --out"):
        others.score_baselines(entries, cases, folders, [cases], None)
