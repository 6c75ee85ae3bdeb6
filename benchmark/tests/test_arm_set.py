"""The blind test from bags to figures: small, but with the diagnosis itself."""

import json
import os
import shlex
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from sim2real.excitation.suite import make_suite

from np_blind.arm import bags as recordings
from np_blind.arm import generate
from np_blind.arm import set as blind
from np_blind.arm.evaluation import dry_run as rehearsal
from np_blind.arm.evaluation.jobs import DiagnosisJob
from np_blind.arm.generate import make_bags
from np_blind.arm.sampling.cases import draw_cases, make_physics
from np_blind.arm.sampling.key import make_key
from np_blind.sealed import SealError, check_diagnosis_code, digest
from np_common.parallel import workers
from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_description.phases import EXCITE, PhaseState
from np_record.bag import Recording
from np_record.recorded_phases import read_phase

ONLY = ["sinusoid_2", "sinusoid_4", "triangle_fast"]  # the diagnosis requires ten blocks of motion
COUNT = 3
TOPICS = ["joint_states", "motor_states", "effort_command", "applied_command", "joint_trajectory", "episode/tick"]
KEYS = {
    "module_accuracy",
    "joint_accuracy",
    "effect_class_accuracy",
    "false_alarm",
    "abstain_out_of_catalogue",
    "pairs_top3",
    "coverage95",
    "shrink_vs_oracle",
    "harm",
    "wall_s",
}


def diagnose_set(out, cases, command):
    """A set of arms with one motion each, diagnosed by a command."""
    options = f"--cases {cases} --set development --only sinusoid_7".split()
    return blind.main([*options, "--out", str(out), "--diagnosis", command])


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blind")
    make_bags(draw_cases(COUNT, 0, "development"), ["sinusoid_7"], folder)
    return folder / "bags"


def test_bags_are_those_of_a_session_and_show_no_cause(bags):
    seen = set()
    for number in range(COUNT):
        with Recording(bags / f"case_{number:03d}", TOPICS) as recording:
            assert set(recording.information) == {"case", "origin"}
            seen.add(tuple(sorted(recording.counts.items())))
            states = [m.decode() for m in recording.messages("joint_states")]
            commands = [m.decode() for m in recording.messages("effort_command")]
            phases = [read_phase("bag", m) for m in recording.messages("episode/phase")]
            order = [m.stamp for m in recording.messages()]
            plan = next(recording.messages("joint_trajectory")).decode()
        assert list(states[0].name) == list(STATE_NAMES) and list(commands[0].name) == list(JOINT_NAMES)
        stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in states]
        assert set(np.diff(stamps)) == {2_000_000} and order == sorted(order)
        assert [m.header.stamp for m in commands] == [m.header.stamp for m in states]
        assert phases == [PhaseState(EXCITE, experiment="sinusoid_7")]
        assert len(plan.points) == len(make_suite(["sinusoid_7"])[0].times)
        swing = np.ptp([m.position[6] for m in states])
        assert swing == pytest.approx(np.ptp(make_suite(["sinusoid_7"])[0].positions[:, 6]), rel=0.1)
    assert len(seen) == 1


def test_no_ros_no_mujoco_and_no_pinocchio_is_needed():
    code = (
        "import sys, np_blind.arm.set, np_blind.arm.generate; "
        "unwanted = ('rclpy', 'pinocchio', 'mujoco', 'torch', 'sim2real.diagnosis'); "
        "print([m for m in unwanted if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_command_scores_the_diagnosis(tmp_path):
    command = [
        sys.executable,
        "-m",
        "np_blind.arm.set",
        "--cases",
        "2",
        "--set",
        "development",
        "--jobs",
        "1",
        "--only",
        *ONLY,
        "--out",
        str(tmp_path / "run"),
        "--diagnosis",
        f"{sys.executable} -m sim2real.cli.diagnose --quick",
    ]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout.splitlines()[-1])
    assert KEYS <= set(figures) and figures["cases"] == 2
    assert figures["errors"] == 0, (tmp_path / "run" / "results.md").read_text()
    assert figures["key_sha256"] == digest((tmp_path / "run" / "key.json").read_text())
    assert figures["key_sha256"] == digest(make_key(2, 0, "development", ONLY))
    assert not list((tmp_path / "run" / "bags").iterdir())
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert [case["case"] for case in results["cases"]] == [0, 1]
    assert (tmp_path / "run" / "results.svg").exists()
    again = subprocess.run(command, capture_output=True, text=True)
    assert again.returncode == 0 and json.loads(again.stdout.splitlines()[-1])["harm"] == figures["harm"]


@pytest.mark.slow
def test_a_case_whose_arm_runs_away_is_published_as_an_error(tmp_path, monkeypatch):
    def one_unstable(cases):
        physics, truths = make_physics(cases)
        for i, case in enumerate(cases):
            if case.number == 1:
                physics.viscous_forward[i] = physics.viscous_backward[i] = -40.0
        return physics, truths

    monkeypatch.setattr(generate, "make_physics", one_unstable)
    monkeypatch.setattr(blind, "workers", ThreadPoolExecutor)
    answer = '{"verdict": "no_gap", "effects": [], "where": []}'
    command = (
        "import pathlib, sys; out = pathlib.Path(sys.argv[-1]); "
        f"(out / 'report.json').write_text({answer!r}); (out / 'patch.yaml').write_text('effects: []')"
    )
    assert diagnose_set(tmp_path, 3, shlex.join([sys.executable, "-c", command])) == 0
    results = json.loads((tmp_path / "results.json").read_text())
    errors = [case["error"] for case in results["cases"]]
    assert errors[0] == errors[2] == "" and errors[1].startswith("no recording: the arm ran away after")
    assert results["figures"]["errors"] == 1 and 1 in results["failures"]


def test_a_locked_key_that_was_not_sealed_is_refused(tmp_path):
    options = ["--cases", "3", "--seed", "987", "--out", str(tmp_path / "run")]
    done = subprocess.run([sys.executable, "-m", "np_blind.arm.set", *options], capture_output=True, text=True)
    assert done.returncode == 1 and "put down (--seal) and committed before the diagnosis runs" in done.stderr
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_second_run_goes_on_and_a_diagnosis_that_crashes_fails_its_own_case_only(tmp_path, monkeypatch):
    monkeypatch.setattr(blind, "workers", ThreadPoolExecutor)
    answer = '{"verdict": "no_gap", "effects": [], "where": []}'
    command = (
        "import pathlib, sys; out = pathlib.Path(sys.argv[-1]); print(out.name); "
        "assert not (out / 'report.json').exists() and 'case_001' not in out.name, 'fell over'; "
        f"(out / 'report.json').write_text({answer!r}); (out / 'patch.yaml').write_text('effects: []')"
    )
    for _ in range(2):  # the diagnosis would fail if it were run again
        assert diagnose_set(tmp_path, 3, shlex.join([sys.executable, "-c", command])) == 0
        results = json.loads((tmp_path / "results.json").read_text())
        assert [bool(case["error"]) for case in results["cases"]] == [False, True, False]
    assert "fell over" in results["cases"][1]["error"] and 1 in results["failures"]


@pytest.mark.slow
def test_a_recording_that_cannot_be_made_fails_its_own_case_only(tmp_path, monkeypatch):
    written = recordings.write_bag

    def full_disk(path, *rest):
        if path.name == "case_001":
            raise OSError("no space left")
        written(path, *rest)

    monkeypatch.setattr(recordings, "write_bag", full_disk)
    monkeypatch.setattr(blind, "workers", ThreadPoolExecutor)
    assert diagnose_set(tmp_path, 2, "false") == 0
    errors = [case["error"] for case in json.loads((tmp_path / "results.json").read_text())["cases"]]
    assert errors[0].startswith("status 1") and "no space left" in errors[1]


@pytest.mark.parametrize("which", ["locked", "locked_changes"])
def test_a_sealed_set_is_not_begun_where_the_diagnosis_does_not_start(which, tmp_path, monkeypatch):
    monkeypatch.setattr(rehearsal, "MOTIONS", ("sinusoid_7",))
    asking = DiagnosisJob(tmp_path, shlex.join([sys.executable, "-c", "import no_such_package"]), 60.0)
    with pytest.raises(SealError, match="no_such_package"):
        rehearsal.check_diagnosis_runs(which, 600, asking, workers)
    assert not list(tmp_path.iterdir())
    rehearsal.check_diagnosis_runs(
        which, 600, replace(asking, diagnosis=shlex.join([sys.executable, "-c", "print(1)"])), workers
    )


def test_a_locked_run_in_parts_is_of_one_diagnosis(tmp_path):
    assert len(check_diagnosis_code(tmp_path, is_locked=True)) == 64
    assert check_diagnosis_code(tmp_path, is_locked=True) == (tmp_path / "diagnosis.sha256").read_text().strip()
    (tmp_path / "diagnosis.sha256").write_text("0" * 64)
    with pytest.raises(SealError, match="its code has changed since"):
        check_diagnosis_code(tmp_path, is_locked=True)
    check_diagnosis_code(tmp_path, is_locked=False)
