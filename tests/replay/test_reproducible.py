"""Lockstep runs with the same seed are equal bit for bit, of processes or of simulated ones; a replayed recording gives the recorded actions."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from graph_tools import card_specs, command, reset
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from simulated_tools import InProcessGraph, InProcessProbe

from np_description.message_arrays import pose_arrays
from np_description.panda import BASE_FRAME
from np_description.phases import ENDS
from np_record.bag import Recording
from np_record.bag_writer import BagWriter
from np_record.topics import TOPICS
from np_ros import qos
from np_ros.phases import phase_state

SEED = 5


def record(graph, probe, folder, weights, episodes):
    """So many short episodes on a card graph; their bags."""
    specs = card_specs(
        {"episode": {"post_timeout": 1.0}},
        keypoints="truth",
        weights=str(weights),
        seed=str(SEED),
        bag=str(folder / "episode"),
        record_at_start="false",
    )
    graph.start(specs)
    phases = probe.collect("episode/phase", DiagnosticArray, qos.LATCHED)
    probe.wait_until_ready({spec.name for spec in specs})
    bags = []
    for _ in range(episodes):
        probe.wait_until(lambda: probe.call("recorder/start").success, what="the recorder")
        assert reset(probe)
        phases.clear()
        assert probe.call("episode/start").success
        probe.wait_until(lambda: phases and phase_state(phases[-1]).phase in ENDS, what="the end")
        answer = json.loads(probe.call("recorder/stop").message)
        assert answer["lost"] == 0
        bags.append(answer["bag"])
    return bags


@pytest.fixture(scope="module")
def bags(tmp_path_factory, untrained):
    """Those of a run of two episodes on simulated processes."""
    graph = InProcessGraph()
    return record(graph, InProcessProbe(graph), tmp_path_factory.mktemp("run"), untrained, 2)


def content(bag):
    """Topic, stamp and bytes of what is reproducible; DDS fills the last four bytes of a message up."""
    with Recording(bag) as recording:
        names = [topic.name for topic in TOPICS if topic.reproducible]
        return [(m.topic.name, m.stamp, m.data + bytes(-len(m.data) % 4)) for m in recording.messages(*names)]


@pytest.mark.slow  # replays say it of every node but the backend, and tests/contract/test_lockstep.py says it of that
def test_processes_give_the_same_bag_as_the_simulated_ones(bags, graph, probe, untrained, tmp_path):
    one, (other,) = bags[0], record(graph, probe, tmp_path, untrained, 1)
    first, second = content(one), content(other)
    assert len(first) > 1000 and first == second


def test_another_episode_gives_another_bag(bags):
    first, second = (Recording(bag).digest() for bag in bags)
    assert first != second


@pytest.mark.parametrize("seed", [SEED, SEED + 1])
def test_the_seed_of_the_graph_draws_the_task(bags, seed):
    """The bridge of the card graph alone draws the recorded task from the recording's seed, and from no other."""
    with Recording(bags[0]) as recording:
        recorded = pose_arrays(next(recording.messages("goal_pose")).decode(), BASE_FRAME)
    graph = InProcessGraph()
    probe = InProcessProbe(graph)
    goals = probe.collect("goal_pose", PoseStamped, qos.LATCHED)
    graph.start([spec for spec in card_specs(keypoints="truth", seed=str(seed)) if spec.name == "sim_bridge"])
    assert probe.call("sim_bridge/reset").success
    probe.wait_until(lambda: goals, what="the goal")
    drawn = pose_arrays(goals[-1], BASE_FRAME)
    assert all(map(np.array_equal, drawn, recorded)) == (seed == SEED)


def test_a_bag_holds_a_whole_episode(bags):
    with Recording(bags[0]) as recording:
        phases = [phase_state(m.decode()).phase for m in recording.messages("episode/phase")]
        states = [m.stamp for m in recording.messages("joint_states")]
    assert phases[:3] == ["pre", "approach", "post"] and phases[-1] in ENDS
    assert set(b - a for a, b in zip(states, states[1:])) == {2_000_000}


def replay(bag):
    done = subprocess.run([*command("np_record", "replay"), str(bag)], capture_output=True, text=True, timeout=280)
    return done, json.loads(done.stdout.splitlines()[-1]) if done.stdout else None


def test_a_replay_gives_the_recorded_actions(bags):
    """Of the second episode: nothing of the first may have been left in a node."""
    done, result = replay(bags[1])
    assert done.returncode == 0, done.stderr
    assert result["identical"] and result["first_mismatch"] is None
    for name in ("effort_command", "target_pose", "target_gains", "joint_trajectory", "pre_contact_pose"):
        counts = result["topics"][name]
        assert counts["expected"] == counts["received"] == counts["identical"] > 0


def test_a_replay_finds_what_was_changed(bags, tmp_path):
    """One joint position off by a nanoradian: the controller's answer to that state differs, and is named."""
    with Recording(bags[0]) as recording:
        writer = BagWriter(tmp_path / "changed", recording.information)
        changed = 0
        for message in recording.messages():
            if message.stamp > recording.start + 1_000_000_000:
                break  # the rest would be replayed as well, and says nothing more
            data = message.data
            if message.topic.name == "joint_states" and not changed and message.stamp > recording.start + 500_000_000:
                state = deserialize_message(data, JointState)
                state.position[2] += 1e-9
                data, changed = serialize_message(state), message.stamp
            writer.write(message.stamp, message.topic, data)
        writer.close()
    done, result = replay(tmp_path / "changed")
    assert done.returncode == 1 and not result["identical"]
    first = result["first_mismatch"]
    assert first["topic"] == "effort_command" and first["stamp"] == changed
    assert "effort[" in first["what"] and "expected" in first["what"]


def test_a_recording_that_cannot_be_replayed_is_named(bags, tmp_path):
    file = tmp_path / "cut" / "cut.mcap"
    file.parent.mkdir()
    whole = next(Path(bags[0]).glob("*.mcap"))
    file.write_bytes(whole.read_bytes()[:-1000])
    for path, text in (
        (file.parent, "expected metadata.yaml"),
        (file, "cut off, or no bag"),
        (tmp_path / "no", "does not exist"),
    ):
        done, result = replay(path)
        assert done.returncode == 1 and result is None and text in done.stderr
        assert "Traceback" not in done.stderr
