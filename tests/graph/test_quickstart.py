"""The quickstart, typed line by line: "Watching an episode"."""

import ast
import json
import os
import re
import shlex
import signal
import subprocess
from pathlib import Path

import pytest
from graph_tools import ROOT, TIMEOUT

QUICKSTART = ROOT / "docs/guide/quickstart.md"


def blocks(heading: str) -> list[list[str]]:
    """The commands of each block of code below a heading, without their remarks."""
    section = QUICKSTART.read_text().partition(f"## {heading}\n")[2].partition("\n## ")[0]
    found = re.findall(r"```\n(.*?)```", section, re.DOTALL)
    return [[line.partition(" #")[0].strip() for line in block.splitlines()] for block in found]


def outcome(answer: str) -> dict:
    """What `ros2 service call /episode/run` printed of the episode; of one that could not begin, why, as a fault."""
    message = ast.literal_eval(re.search(r"message=(['\"].*['\"])\)", answer)[1])
    return json.loads(message) if message.startswith("{") else {"phase": "fault", "reason": message}


@pytest.mark.real_time
def test_watching_an_episode_in_real_time(graph, tmp_path: Path):
    environment = {**os.environ, **graph.environment}

    def type_line(line: str) -> str:
        done = subprocess.run(shlex.split(line), env=environment, capture_output=True, text=True, timeout=4 * TIMEOUT)
        assert done.returncode == 0, f"{line}: {done.stdout}{done.stderr}"
        return done.stdout + done.stderr

    (launch, goal, run), _, (recover, *after) = blocks("Watching an episode")
    said = open(tmp_path / "launch.log", "w")
    own_shell = subprocess.Popen([*shlex.split(launch), "keypoints:=truth"], env=environment, stdout=said, stderr=said)
    try:
        assert "goal taken" in type_line(goal)
        ended = outcome(type_line(run))
        assert "reset" not in ended["reason"]  # it was in force before the start
        if ended["phase"] == "fault":  # a busy machine: what the page says of it then
            assert any("success=True" in type_line(recover) for _ in range(30))
            reset, again = after
            assert "success=True" in type_line(reset)
            ended = outcome(type_line(again))
        assert ended["phase"] in ("succeeded", "failed", "fault"), ended
        assert ended["phase"] != "succeeded" or ended["distance_m"] < 0.01
    finally:
        own_shell.send_signal(signal.SIGINT)
        assert own_shell.wait(TIMEOUT) == 0
        said.close()
