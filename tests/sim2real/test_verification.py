"""A patch against a recording that it was not made from."""

import json
from dataclasses import replace

import pytest
from own_simulator import record
from sim2real.cli import diagnose
from sim2real.effects.patch import Patch, PatchEffect, dump_patch
from sim2real.simulation.verification import verification_sentence, verify_patch, write_verification

FRICTION = PatchEffect("coulomb_friction", "panda_joint4", {"level": 0.4})
WRONG = PatchEffect("coulomb_friction", "panda_joint4", {"level": -0.3})
ELSEWHERE = PatchEffect("coulomb_friction", "panda_joint7", {"level": 0.02})


@pytest.fixture(scope="module")
def log():
    return record(["sinusoid_4"], Patch((FRICTION,)))


def test_the_right_patch_removes_what_the_simulator_departs_by(log):
    found = verify_patch([log], Patch((FRICTION,)))
    assert found["verdict"] == "better" and found["removed"] > 0.9 and found["windows"] >= 3
    low, high = found["removed_ci95"]
    assert 0.9 < low <= found["removed"] <= high <= 1
    four = found["by_joint_rad"]["panda_joint4"]
    assert four["after"] < 0.05 * four["before"]
    assert verification_sentence(found).startswith(f"The patch removes {100 * found['removed']:.1f} % (95 %: ")


def test_a_wrong_patch_is_called_worse_and_an_empty_one_the_same(log):
    worse = verify_patch([log], Patch((WRONG,)))
    assert worse["verdict"] == "worse" and worse["removed"] < -0.2 and "further away" in verification_sentence(worse)
    same = verify_patch([log], Patch())
    assert same["verdict"] == "same" and same["removed"] == 0 and "changes nothing" in verification_sentence(same)


def test_a_recording_without_commands_is_refused(log):
    with pytest.raises(ValueError, match="expected effort_command"):
        verify_patch([replace(log, commands=None)], Patch())


def test_the_command_writes_what_it_says(log, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(diagnose, "_load_all", lambda paths, arm: [log])
    patch = tmp_path / "patch.yaml"
    patch.write_text(dump_patch(Patch((FRICTION, ELSEWHERE))))
    out = tmp_path / "verified"
    assert diagnose.main(["new_bag", "--out", str(out), "--patch", str(patch)]) == 0
    said, last = capsys.readouterr().out.splitlines()
    assert said.startswith("The patch removes") and json.loads(last)["verdict"] == "better"
    assert json.loads((out / "verification.json").read_text())["removed"] == json.loads(last)["removed"]
    patch.write_text("effects: none")
    assert diagnose.main(["new_bag", "--out", str(out), "--patch", str(patch)]) == 1
    assert "expected a mapping with the list 'effects'" in capsys.readouterr().err
    assert diagnose.main(["new_bag", "--out", str(out), "--patch", str(patch), "--no-hand"]) == 1
    assert write_verification(tmp_path / "new", {"removed": 1.0}).exists()
