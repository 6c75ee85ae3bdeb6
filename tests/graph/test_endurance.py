"""`soak` and `fuzz` on a whole graph, short."""

import json

import pytest

from np_evaluation.commands import fuzz, soak


def last_line(capsys) -> dict:
    """What a command printed last."""
    return json.loads(capsys.readouterr().out.splitlines()[-1])


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_no_node_grows_over_twenty_episodes(tmp_path, capsys):
    """Twenty say little of a slow leak; that handles and threads stay, and that the figures are there."""
    assert soak.main(["--episodes", "20", "--memory", "2000", "--out", str(tmp_path / "soak")]) == 0
    found = last_line(capsys)
    assert found["episodes"] == 20 and not found["growing"] and not found["error"]
    assert {"sim_bridge", "joint_impedance", "episode", "post_contact"} <= set(found["nodes"])


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_no_node_dies_of_what_nobody_should_send(tmp_path, capsys):
    topics = ["joint_states", "keypoints", "episode/tick", "target_pose"]
    assert fuzz.main(["--messages", "100", "--out", str(tmp_path / "fuzz"), "--topics", *topics]) == 0
    found = last_line(capsys)
    assert [one["topic"] for one in found["by_topic"]] == topics and found["messages"] == 400
    assert not found["died"] and not found["silent"]
    states = found["by_topic"][0]["refused"]
    # The policies read a state's stamp, and the rest of it when they decide: most of what is broken they never look at.
    assert states["joint_impedance"] > 20 and states["approach"] and states["post_contact"]


def test_options_that_cannot_be_are_refused(capsys):
    for command, arguments, text in (
        (soak, ["--episodes", "3"], "expected at least 20, got 3"),
        (soak, ["--hours", "0"], "expected more than 0, got 0"),
        (fuzz, ["--topics", "nobody"], "got nobody"),
    ):
        with pytest.raises(SystemExit):
            command.main(arguments)
        assert text in capsys.readouterr().err
