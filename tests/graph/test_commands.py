"""The commands as a user runs them: whole graphs of processes, to the last line of JSON."""

import json
import os
import re
import signal
import subprocess

import pytest
from graph_tools import command

from np_description.phases import ENDS
from np_evaluation.commands import demo, evaluate, fuzz, soak
from np_record.bag import Recording

LIMIT = 280  # s


def start(name, weights, *options):
    return subprocess.Popen(
        [*command("np_evaluation", name), "--weights", str(weights), *map(str, options)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process):
    """(status, JSON of the last line, standard output, standard error)."""
    try:
        out, err = process.communicate(timeout=LIMIT)
    finally:
        if process.poll() is None:
            process.terminate()
            process.wait(30)
    return process.returncode, json.loads(out.splitlines()[-1]) if out else None, out, err


def survivors(log_folder):
    """Processes that still use the parameter files of a run."""
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{pid}/cmdline", "rb") as file:
                if str(log_folder).encode() in file.read():
                    found.append(int(pid))
        except OSError:
            continue  # ended meanwhile
    return found


def test_the_demo_records_and_reports(tmp_path, untrained):
    """Two episodes with the camera. An untrained detector ends them early, but with a named phase."""
    status, result, out, err = finish(
        start("demo", untrained, "--episodes", 2, "--image-rate", 10, "--out", tmp_path / "demo")
    )
    assert status == 0, err
    folder = tmp_path / "demo_000"
    assert result["episodes"] == 2 and result["error"] == "" and len(result["bags"]) == 2
    assert all(outcome.split(":")[0] in ENDS for outcome in result["outcomes"])
    for bag in result["bags"]:
        with Recording(
            bag, ["joint_states", "camera/image_raw", "keypoints", "goal_pose", "episode/phase"]
        ) as recording:
            assert recording.information["seed"] == "0" and recording.information["weights_sha256"]
    report = (folder / "report.html").read_text()
    assert "episode_000" in report and "episode_001" in report and "data:video/webm" in report
    assert all(os.path.getsize(video) > 0 for video in result["videos"]) and len(result["videos"]) == 2
    assert "episode 1 of 2" in out and " pre" in out
    assert survivors(folder) == []


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_the_demo_cleans_up_when_it_is_interrupted(tmp_path, untrained, number):
    process = start("demo", untrained, "--keypoints", "truth", "--out", tmp_path / "demo")
    lines = []
    for line in process.stdout:
        lines.append(line)
        if line.split()[-1:] == ["approach"]:
            break
    assert survivors(tmp_path / "demo_000"), "".join(lines)
    process.send_signal(number)
    status, result, _, err = finish(process)
    assert status == 130 and "Traceback" not in err, err
    assert result["error"] == "interrupted"
    assert survivors(tmp_path / "demo_000") == []
    with Recording(result["bags"][0], ["joint_states", "joint_trajectory"]) as recording:
        assert recording.counts["joint_states"] > 0  # the episode that was cut off is kept as well


@pytest.mark.parametrize(
    ("command", "options"),
    [(demo, ["--episodes", "1"]), (evaluate, ["--episodes", "1"]), (soak, []), (fuzz, [])],
    ids=lambda one: one.__name__.rpartition(".")[2] if not isinstance(one, list) else "",
)
def test_a_domain_id_that_is_none_is_told_though_the_graph_has_one_of_its_own(
    tmp_path, monkeypatch, capsys, command, options
):
    """Whoever set it meant something by it."""
    monkeypatch.setenv("ROS_DOMAIN_ID", "abc")
    assert command.main([*options, "--out", str(tmp_path / "out")]) == 1
    name = command.__name__.rpartition(".")[2]
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith(f"{name}: ")]
    assert said == [f"{name}: ROS_DOMAIN_ID: expected a whole number from 0 to 232, got 'abc'"]


def test_missing_weights_are_named(tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    status, result, _, err = finish(start("demo", empty, "--out", tmp_path / "demo"))
    assert status == 1 and "_card" in err and "does not exist" in err
    assert result["episodes"] == 0 and result["error"]
    assert survivors(tmp_path / "demo_000") == []


@pytest.mark.slow
def test_an_evaluation_counts_and_goes_on_where_it_stopped(tmp_path, untrained):
    options = ("--keypoints", "camera", "--seed", 3, "--out", tmp_path / "eval")
    status, first, _, err = finish(start("evaluate", untrained, "--episodes", 1, *options))
    assert status == 0, err
    assert (first["object"], first["scenario"]) == ("default", 0)
    assert first["episodes"] == 1 and first["warnings"] == [] and first["kept"] == 0 and "kept from" not in err
    status, second, _, err = finish(start("evaluate", untrained, "--episodes", 2, *options))
    assert status == 0, err
    lines = [json.loads(line) for line in open(second["results"])]
    assert [line["episode"] for line in lines[1:]] == [0, 1] and first["results"] == second["results"]
    assert second["ci95"][0] <= second["success"] <= second["ci95"][1]
    assert sum(second["failures"].values()) == 2 - round(2 * second["success"])
    assert second["kept"] == 1 and re.search(r"kept from 20\d\d-.*, 1 of 2 episodes", err)
    # Of the first nothing was run again: its wall time is in the sum, not in this run.
    assert second["episodes"] == 2 and second["wall_s"] > sum(line["wall_s"] for line in lines[1:])


def test_a_graph_that_breaks_down_costs_its_episode(tmp_path, untrained):
    process = start("evaluate", untrained, "--episodes", 1, "--keypoints", "truth", "--out", tmp_path / "eval")
    victim = None
    while victim is None:
        assert process.poll() is None
        victim = next((pid for pid in survivors(tmp_path / "eval/log_000/post_contact.yaml")), None)
    os.kill(victim, signal.SIGKILL)
    status, result, _, err = finish(process)
    if status == 1:  # killed before the graph was up: nothing to count
        assert "post_contact ended with signal SIGKILL" in err
    else:
        assert status == 0 and result["failures"] == {"graph": 1} and result["success"] == 0.0
