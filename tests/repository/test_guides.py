"""The code of the guides, run as it stands, page by page."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
AFTER = {
    "your_own_object": "assert domain.half_size == (0.03, 0.035, 0.003) and abs(scene.body('object').mass[0] - 0.012) < 1e-9 and TILE.mass > 0",
    "your_own_robot": "assert worn.velocity_limit[0] == limits.velocity[0] and scene.dof_frictionloss[0] > 0.2 and '<robot' in text",
    "your_own_effect": "assert felt.shape == (1, 7) and abs(felt[0, 1]) > 1 and abs(felt[0, 0]) < 1e-6",
}


def code(page: str) -> str:
    """Every block of Python of a guide."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / f"docs/guide/{page}.md").read_text(), re.DOTALL)
    assert blocks
    return "\n".join(blocks)


def run(command: list[str], folder: Path) -> str:
    environment = {**os.environ, "NP_EFFECTS_PATH": str(ROOT / "examples/effects")}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("page", AFTER)
def test_the_code_of_a_guide_does_what_it_says(page, tmp_path):
    said = run([sys.executable, "-c", f"{code(page)}\n{AFTER[page]}"], tmp_path)
    if page == "your_own_effect":
        assert "force_z -30 to 30 N" in said


def test_a_loaded_arm_of_six_hinges_is_diagnosed_by_its_motor_current_as_the_guide_has_it(tmp_path):
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    run([sys.executable, "-c", code("diagnose")], tmp_path)
    text = (ROOT / "docs/guide/diagnose.md").read_text()
    line = re.search(r"ros2 run np_diagnosis diagnose (loaded\.npz .*)", text)[1]
    said = run([sys.executable, "-m", "sim2real.cli.diagnose", *line.split()], tmp_path)
    assert json.loads(said.splitlines()[-1])["effects"] == ["payload at arm"]
    (entry,) = yaml.safe_load((tmp_path / "runs/six/patch.yaml").read_text())["effects"]
    assert 0.38 < entry["parameters"]["mass"] < 0.42


def test_another_arm_is_diagnosed_as_the_guide_has_it(tmp_path):
    run([sys.executable, "-c", code("your_own_robot")], tmp_path)
    text = (ROOT / "docs/guide/your_own_robot.md").read_text()
    line = re.search(r"ros2 run np_diagnosis diagnose (run\.npz .*)", text)[1]
    said = run([sys.executable, "-m", "sim2real.cli.diagnose", *line.split()], tmp_path)
    assert json.loads(said.splitlines()[-1])["effects"] == ["coulomb_friction at elbow"]
    assert "coulomb_friction" in (tmp_path / "report/patch.yaml").read_text()
