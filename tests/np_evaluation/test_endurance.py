"""The parts of soak and fuzz that need no graph."""

import gc
import json
import mmap
import os
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message

from np_description.message_arrays import BadMessage, joint_state_arrays
from np_description.panda import STATE_NAMES
from np_evaluation.commands import common, soak
from np_evaluation.endurance.random_messages import break_bytes, break_message, message_type, random_message
from np_evaluation.endurance.resources import ResourceUse, Trend, find_growing, measure_use, trend
from np_record.topics import TOPICS
from np_ros.messages import joint_state_message

KINDS = sorted({topic.type for topic in TOPICS})


@pytest.mark.parametrize("name", KINDS)
def test_a_random_message_of_every_type_can_be_sent(name):
    rng, kind = np.random.default_rng(0), message_type(name)
    sent = {serialize_message(random_message(kind, rng)) for _ in range(50)}
    assert len(sent) > 10 or "std_msgs" in name
    for data in sent:
        deserialize_message(data, kind)


def test_a_soak_that_goes_on_is_a_result_of_so_many_episodes(tmp_path):
    """Whoever kills it has what there was: the file is whole at any moment."""
    run = soak.SoakRun({"mode": "lockstep"}, allowed=20.0, revision="abc")
    run.ends["succeeded"] = 25
    run.uses["episode"] = [ResourceUse(1000 + number, 18, 14) for number in range(25)]
    result = run.write(tmp_path / "soak.json", "not finished: 25 episodes so far")
    kept = json.loads((tmp_path / "soak.json").read_text())
    assert [path.name for path in tmp_path.iterdir()] == ["soak.json"]
    assert (
        kept["episodes"] == 25
        and kept["revision"] == "abc"
        and kept["nodes"]["episode"]["memory_per_episode"] == pytest.approx(1.0)
    )
    assert result["growing"] == [] and len(kept["uses"]["episode"]) == 25
    run.uses["episode"] = run.uses["episode"][:15]
    assert "expected at least 10 episodes after 10" in run.result("")["error"]


def test_a_fault_is_an_end_after_which_a_soak_goes_on(tmp_path, monkeypatch):
    """Once in some hundred episodes a guard stops the arm: that says nothing of memory."""
    ends = ["succeeded", "fault", *["succeeded"] * 20]

    class Conductor:
        recovered = 0

        def run_episode(self, until):
            assert self.recovered == ends[: run.episodes].count("fault")
            return SimpleNamespace(declared=ends[run.episodes])

        def recover(self):
            self.recovered += 1

        def processes(self):
            return {"episode": os.getpid()}

    monkeypatch.setattr(common, "running_graph", lambda *_: nullcontext(Conductor()))
    run = soak.SoakRun({"mode": "lockstep"}, allowed=20.0, revision="abc")
    soak.episodes(run, soak.parser().parse_args(["--episodes", str(len(ends))]), tmp_path)
    assert run.ends == {"succeeded": 21, "fault": 1}


def test_a_broken_message_is_one_that_is_refused_or_differs():
    rng = np.random.default_rng(0)
    good = joint_state_message(2_000_000, STATE_NAMES, np.zeros(9), np.zeros(9), np.zeros(9))
    refused = 0
    for _ in range(200):
        bad = break_message(good, rng)
        assert bad != good or bad is not good
        try:
            joint_state_arrays(bad, STATE_NAMES)
        except BadMessage:
            refused += 1
    assert 50 < refused < 200  # some changes are harmless, as of a frame that nobody reads
    assert good == joint_state_message(2_000_000, STATE_NAMES, np.zeros(9), np.zeros(9), np.zeros(9))


def test_broken_bytes_keep_their_first_four():
    rng, data = np.random.default_rng(0), bytes(range(100))
    made = [break_bytes(data, rng) for _ in range(100)]
    assert all(one[:4] == data[:4] and len(one) <= 100 for one in made)
    assert len(set(made)) > 90 and data not in made


def test_what_grows_is_named():
    flat = [ResourceUse(50_000 + i % 3, 20, 5) for i in range(60)]
    leak = [ResourceUse(50_000 + 100 * i, 20, 5) for i in range(60)]
    handles = [ResourceUse(50_000, 20 + i // 20, 5) for i in range(60)]
    warming = [ResourceUse(10_000 * min(i, 9), 5 + min(i, 9), 1 + min(i, 9)) for i in range(60)]
    trends = {name: trend(uses, 10) for name, uses in locals().items() if isinstance(uses, list)}
    assert find_growing(trends, 10.0) == ["leak", "handles"]
    assert trends["leak"].memory_per_episode == pytest.approx(100)
    assert trends["handles"].handles[1] > trends["handles"].handles[0]
    assert isinstance(trends["warming"], Trend)
    with pytest.raises(ValueError, match="at least 10 episodes after 10 of warm-up, got 5"):
        trend(flat[:15], 10)


def test_use_of_this_process():
    gc.collect()  # what others have left open is not closed meanwhile
    before = measure_use(os.getpid())
    with open(os.devnull):
        assert measure_use(os.getpid()).handles == before.handles + 1
    assert before.memory > 1000 and before.threads >= 1


def test_pages_of_a_file_that_is_read_are_no_memory_of_ones_own(tmp_path):
    """As those of a library are, whose rare path is run for the first time after a hundred episodes."""
    size = 16_000_000
    (tmp_path / "library").write_bytes(os.urandom(size))
    with (tmp_path / "library").open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as pages:
        before = measure_use(os.getpid()).memory
        assert sum(pages[:: mmap.PAGESIZE]) > 0
        assert measure_use(os.getpid()).memory - before < 1000
    with mmap.mmap(-1, size) as own:
        own.write(os.urandom(size))
        assert measure_use(os.getpid()).memory - before > 0.9 * size / 1000 - 1000
