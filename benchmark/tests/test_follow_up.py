"""The second recording of the blind test: made where it is requested, of the same arm, and judged
strictly."""

import json

import numpy as np
import pytest
from sim2real.recordings.reading import load_log

from np_blind.arm.evaluation.follow_up import could_settle, follow_up, is_answered, suggested_experiment
from np_blind.arm.generate import bag_path, make_bags
from np_blind.arm.sampling.cases import ArmCase
from np_blind.arm.sampling.faults import Fault
from np_description.panda import JOINT_NAMES
from np_record.bag import Recording

CASE = ArmCase(3, "single", (Fault("coulomb_friction", 6, 8.0),), (1, 2, 3))
TRUTH = {"effect": "coulomb_friction", "component": "panda_joint7"}


def report(verdict="ambiguous", experiment="sinusoid_7", effects=(TRUTH,), command=True):
    wanted = {"name": experiment, **({"command": "excite"} if command else {})}
    return {
        "verdict": verdict,
        "next_experiment": wanted,
        "effects": [{**e, "is_added": True} for e in effects],
    }


def put(folder, content):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "report.json").write_text(json.dumps(content))


@pytest.mark.parametrize(
    "content, name",
    [
        (report(), "sinusoid_7"),
        (report("identified"), None),
        (report(experiment="none of them can", command=False), None),
        ({"verdict": "ambiguous", "next_experiment": None}, None),
    ],
)
def test_only_an_open_question_with_an_experiment_gets_one(tmp_path, content, name):
    put(tmp_path, content)
    assert suggested_experiment(tmp_path) == name


def test_without_a_report_there_is_none(tmp_path):
    assert suggested_experiment(tmp_path) is None


def test_the_second_recording_is_of_the_same_arm_with_other_noise(tmp_path):
    make_bags([CASE], ["sinusoid_7"], tmp_path)
    folder, seen = tmp_path / "reports", []
    put(folder, report())

    def ask(bags, answer):
        logs = [load_log(bag) for bag in bags]
        with Recording(bags[1], ["joint_states"]) as recording:
            seen.append(recording.information)
        put(answer, report("identified"))
        one, other = logs
        assert one.time[-1] == pytest.approx(other.time[-1])
        noise = one.torque - other.torque
        # The same fault: friction of the wrist differs far less than the noise of a single reading.
        moving = np.abs(one.velocity[:, 6]) > 0.1
        direction = np.sign(one.velocity[moving, 6])
        level = [(log.torque[moving, 6] * direction).mean() for log in logs]
        assert level[0] == pytest.approx(level[1], rel=0.05) and noise.std() > 1e-3
        return ""

    follow_up(CASE, bag_path(tmp_path, 3), folder, ask)
    assert seen == [{"origin": "np_diagnosis blind test", "case": 3}]
    assert is_answered({"kind": "single", "faults": [TRUTH]}, folder) is True
    assert [path.name for path in (tmp_path / "bags").iterdir()] == ["case_003"]  # the second one is gone


def test_an_experiment_that_nobody_knows_is_no_answer(tmp_path):
    put(tmp_path, report(experiment="juggling"))
    follow_up(CASE, tmp_path / "bag", tmp_path, lambda *_: pytest.fail("nothing to ask about"))
    assert "expected one of" in (tmp_path / "next" / "error.txt").read_text()
    assert is_answered({"kind": "single", "faults": [TRUTH]}, tmp_path) is False


@pytest.mark.parametrize(
    "kind, verdict, effects, settled",
    [
        ("single", "identified", [TRUTH], True),
        ("single", "ambiguous", [TRUTH], False),
        ("single", "identified", [{**TRUTH, "effect": "viscous_friction"}], False),
        ("single", "identified", [TRUTH, {"effect": "payload", "component": "arm"}], False),
        ("null", "no_gap", [], True),
        ("null", "identified", [TRUTH], False),
        ("stranger", "unexplained", [TRUTH], True),
        ("stranger", "identified", [TRUTH], False),
    ],
)
def test_settled_means_sure_and_right(tmp_path, kind, verdict, effects, settled):
    put(tmp_path / "next", report(verdict, effects=effects))
    (tmp_path / "next" / "error.txt").write_text("")
    assert is_answered({"kind": kind, "faults": [TRUTH] if kind == "single" else []}, tmp_path) is settled
    assert JOINT_NAMES[6] == TRUTH["component"]


def test_cases_without_a_second_recording_are_not_counted(tmp_path):
    assert is_answered({"kind": "null", "faults": []}, tmp_path) is None


WRIST = {"component": TRUTH["component"]}
OFFSET, SCALE = {"effect": "torque_offset", **WRIST}, {"effect": "torque_scale", "component": "panda_joint1"}


@pytest.mark.parametrize(
    "separates, named, faults, could",
    [
        (["torque_offset", "coulomb_friction"], [OFFSET], [TRUTH], True),  # a rival is the truth
        (["coulomb_friction", "nothing"], [TRUTH], [TRUTH], True),  # what is named is
        (["torque_offset", "cable_torque"], [OFFSET], [TRUTH], False),
        (["torque_offset", "coulomb_friction"], [OFFSET, SCALE], [TRUTH], False),  # something wrong stays beside it
        (["torque_offset", "coulomb_friction"], [OFFSET, SCALE], [TRUTH, SCALE], True),
        (["torque_offset", "viscous_friction + coulomb_friction"], [OFFSET], [TRUTH], False),
        (["torque_offset", "nothing"], [OFFSET], [], True),
    ],
)
def test_an_experiment_can_settle_what_has_the_truth_among_its_models(tmp_path, separates, named, faults, could):
    content = report(effects=named)
    content["next_experiment"] |= {"separates": separates, **WRIST}
    put(tmp_path, content)
    assert could_settle({"kind": "single" if faults else "null", "faults": faults}, tmp_path) is could
    assert could_settle({"kind": "stranger", "faults": [TRUTH]}, tmp_path) is False
    put(tmp_path, report("identified", effects=named))
    assert could_settle({"kind": "single", "faults": faults}, tmp_path) is False
