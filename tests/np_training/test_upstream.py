"""The patch for MuJoCo Warp is what our own sources give, applies to the installed version, and solves there."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import mujoco_warp
import pytest

UPSTREAM = Path(__file__).parents[2] / "training" / "upstream"
PATCH = UPSTREAM / "fused_newton.patch"


def run(*command, cwd, **environment):
    return subprocess.run(
        command, cwd=cwd, env=os.environ | environment, check=True, capture_output=True, text=True
    ).stdout


@pytest.mark.slow
def test_the_patch_is_up_to_date_and_the_patched_library_solves_as_before(tmp_path):
    assert run(sys.executable, UPSTREAM / "make_patch.py", cwd=tmp_path) == PATCH.read_text()
    shutil.copytree(Path(mujoco_warp.__file__).parent, tmp_path / "mujoco_warp")
    run("git", "init", "-q", cwd=tmp_path)
    run("git", "apply", "--check", PATCH, cwd=tmp_path)
    run("git", "apply", PATCH, cwd=tmp_path)
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    command = sys.executable, UPSTREAM / "benchmark.py", "--worlds", "2", "--steps", "100"
    figures = json.loads(run(*command, cwd=tmp_path, PYTHONPATH=path).splitlines()[-1])
    assert figures["moved_mm"] > 1 and figures["apart_mm_max"] < 0.1
