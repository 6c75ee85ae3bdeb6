"""An effect of one's own, in a folder of one's own, from the file to its name in a report."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from sim2real.effects.registry import FOLDERS
from sim2real.excitation.suite import NAMES

HERE = Path(__file__).resolve()
EXPERIMENTS = ["sinusoid_2", "sinusoid_4", "dwell"]
SCRIPT = """
import json, sys
sys.path.insert(0, sys.argv[1])
from own_simulator import record
from sim2real.diagnosis import diagnose
from sim2real.effects.patch import Patch, PatchEffect
pull = PatchEffect("steady_pull", "arm", {"force_x": 3.0, "force_z": 4.0})
found = diagnose([record(json.loads(sys.argv[2]), Patch((pull,)))])
print(json.dumps([[f.effect.id, f.component, {k: [v.low, v.high] for k, v in f.parameters.items()}]
                  for f in found.findings if f.is_chosen]))
"""


@pytest.mark.slow
def test_a_steady_pull_is_found_by_its_own_name_and_size():
    assert set(EXPERIMENTS) <= set(NAMES)
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(HERE.parents[1]), json.dumps(EXPERIMENTS)],
        env={**os.environ, FOLDERS: str(HERE.parents[2] / "examples" / "effects")},
        capture_output=True,
        text=True,
        timeout=280,
    )
    assert run.returncode == 0, run.stderr[-2000:]
    ((effect, component, forces),) = json.loads(run.stdout.splitlines()[-1])
    assert (effect, component) == ("steady_pull", "arm")
    assert forces["force_x"][0] < 3.0 < forces["force_x"][1] and forces["force_z"][0] < 4.0 < forces["force_z"][1]
