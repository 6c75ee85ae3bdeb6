"""The examples do what they say."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"


def run(folder: Path, name: str, *arguments: str) -> str:
    """What an example prints, run in `folder`."""
    command = [sys.executable, str(EXAMPLES / name), *arguments]
    done = subprocess.run(command, cwd=folder, env={**os.environ}, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_every_example_is_in_the_table():
    listed = set(re.findall(r"\d\d_\w+\.(?:py|md)", (EXAMPLES / "README.md").read_text()))
    assert listed == {path.name for path in EXAMPLES.glob("[0-9][0-9]_*")}


@pytest.mark.slow
def test_a_demo_and_its_bag(tmp_path):
    out = tmp_path / "demo"
    options = ["--domain", "wall", "--episodes", "1", "--keypoints", "truth", "--out", str(out)]
    printed = json.loads(run(ROOT, "00_demo.py", *options).splitlines()[-1])
    assert printed["episodes"] == 1
    (bag,) = (path.parent for path in tmp_path.rglob("metadata.yaml"))
    text = run(tmp_path, "01_read_a_bag.py", str(bag))
    assert "joint_states" in text and "500.0 Hz" in text and "phase: " in text


@pytest.mark.slow
def test_a_diagnosis_without_ros_finds_the_load(tmp_path):
    text = run(tmp_path, "02_diagnose_without_ros.py")
    mass = float(re.search(r"^payload at arm: .*mass ([\d.]+)", text, re.MULTILINE)[1])
    assert 0.38 < mass < 0.42


@pytest.mark.slow  # np_evaluation/test_one_process.py plays episodes in the same way
def test_a_rollout_in_one_process(tmp_path):
    assert re.fullmatch(
        r"episode 0: .+, [\d.]+ mm from the goal after [\d.]+ s\n", run(tmp_path, "03_rollout_in_process.py")
    )


def test_an_object_of_ones_own(tmp_path):
    text = run(tmp_path, "04_own_object.py")
    assert "(0.03, 0.035, 0.003)" in text and "mass, kg: 0.012" in text and (tmp_path / "tea.yaml").exists()


def test_an_effect_of_ones_own(tmp_path):
    text = run(tmp_path, "05_own_effect.py")
    torque = np.array(re.search(r"Nm: \[(.*)\]", text)[1].split(), float)
    assert "force_z -30 to 30 N" in text and torque.shape == (7,) and abs(torque[1]) > 1 and abs(torque[0]) < 1e-6


@pytest.mark.slow
def test_a_finetuning_with_a_patch(tmp_path):
    printed = run(tmp_path, "06_finetune_with_a_patch.py")
    assert 0 <= json.loads(printed.splitlines()[-1])["success_predicted"] <= 1
