"""`check_backend` on a backend that keeps all but one thing."""

import json
import os
import subprocess
import sys

import pytest
from graph_tools import ROOT, TIMEOUT, command

FORGETFUL = f"""
import sys
sys.path.insert(0, {str(ROOT / "examples")!r})
from importlib import import_module
from np_ros.node import run

minimal_backend = import_module("08_minimal_backend")

class Forgetful(minimal_backend.MinimalBackend):
    def _on_gripper(self, message):
        "Carries out what it has to refuse, and says nothing."
        self._arm.opening = 0.0 if message.data != message.data else message.data

sys.exit(run(Forgetful))
"""


@pytest.mark.slow
def test_what_a_backend_does_not_keep_is_named_and_the_rest_is_judged(graph, probe, tmp_path):
    environment = {**os.environ, **graph.environment}
    (tmp_path / "forgetful.py").write_text(FORGETFUL)
    backend = subprocess.Popen([sys.executable, str(tmp_path / "forgetful.py")], env=environment)
    try:
        probe.wait_until(lambda: probe.publishers("joint_states"), what="the backend")
        judged = subprocess.run(
            [*command("np_evaluation", "check_backend"), "minimal_backend", "--limit", "10"],
            env=environment,
            capture_output=True,
            text=True,
            timeout=4 * TIMEOUT,
        )
    finally:
        backend.terminate()
        backend.wait(TIMEOUT)
    *lines, last = judged.stdout.splitlines()
    summary = json.loads(last)
    assert summary["broken"] == ["a bad gripper command is refused"], judged.stdout
    assert judged.returncode == 1
    failed = [line for line in lines if line.startswith("FAIL")]
    assert len(failed) == 1 and "refused_gripper to grow for nan" in failed[0]
    assert summary["kept"] == len([line for line in lines if line.startswith("ok")]) >= 10


def test_nobody_to_judge_is_said(graph):
    judged = subprocess.run(
        [*command("np_evaluation", "check_backend"), "my_arm", "--limit", "1"],
        env={**os.environ, **graph.environment},
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
    )
    assert judged.returncode == 2 and "expected a node my_arm in this ROS_DOMAIN_ID within 1 s" in judged.stderr
