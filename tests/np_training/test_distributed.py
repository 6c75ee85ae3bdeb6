"""Training in several processes, as torchrun starts them: the same update as in one."""

import csv
import json
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from learn_together import learn

from np_training import train
from np_training.ppo import distributed

TOGETHER = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node"]


def launch(processes: int, *command: str) -> str:
    """Standard output of a command run by torchrun; fails with what it printed."""
    done = subprocess.run([*TOGETHER, str(processes), *command], capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


SHARES = (30, 40, 0)  # of 60 rows, for the first process: evenly, unevenly, nothing


@pytest.fixture(scope="module")
def batch():
    generator = torch.Generator().manual_seed(1)
    state = torch.randn(60, 18, generator=generator)
    action, likely = 0.5 * torch.randn(60, 9, generator=generator), -9 + torch.randn(60, generator=generator)
    return state, state, action, likely, *torch.randn(2, 60, generator=generator)


@pytest.fixture(scope="module")
def out(batch, tmp_path_factory):
    """Where two processes said, each in a file of its own, what they came to."""
    folder = tmp_path_factory.mktemp("together")
    parts = [[[column[:share] for column in batch], [column[share:] for column in batch]] for share in SHARES]
    torch.save(parts, folder / "in.pt")
    launch(2, str(Path(__file__).parents[1] / "learn_together.py"), str(folder / "in.pt"), str(folder / "out"))
    return folder


@pytest.mark.slow
def test_an_update_shared_by_two_processes_is_that_of_one(batch, out):
    weights, statistics, rate = learn(batch)
    for rank in (0, 1):
        results = torch.load(out / f"out.{rank}", weights_only=True)
        assert len(results) == len(SHARES)
        for mine, said, mine_rate in results:
            assert mine_rate == rate and said == pytest.approx(statistics, rel=1e-3)
            for name, tensor in weights.items():
                # Adam divides by the gradient's size, so rounding shows where a gradient is nearly zero.
                assert (mine[name] - tensor).abs().max() < 1e-4, name


@pytest.mark.slow
def test_all_processes_go_on_from_the_furthest_checkpoint_and_differences_are_seen(out):
    for rank in (0, 1):
        said = json.loads((out / f"out.{rank}.json").read_text())
        assert said["state"] == {"steps": 7, "weights": [1.0, 2.0]}, "the second process had gone further"
        assert "found differences up to 0.5" in said["before"] and said["after"] == ""
        assert said["weight"] == 1.0
        assert said["decided"] == [True, False], "one process is enough to decide for all"
        assert said["total"] == {"number": 3.0, "one": 2.0}


@pytest.mark.slow
def test_two_groups_on_two_hosts_train_as_one_and_one_of_them_has_the_checkpoint(tmp_path):
    """Two launches with a rendezvous, as on two machines without a shared disk; which of them is the first may change."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"127.0.0.1:{free.getsockname()[1]}"
    group = [sys.executable, "-m", "torch.distributed.run", "--nnodes", "2", "--nproc-per-node", "1"]
    group += ["--rdzv-backend", "c10d", "--rdzv-endpoint", endpoint, "-m", "np_training.train"]
    options = ["--worlds", "4", "--set", "rollout=2", "--device", "cpu", "--iterations", "1"]
    for steps in (4 * 2, 2 * 4 * 2):  # from nothing, then from the checkpoint
        hosts = [
            subprocess.Popen(
                [*group, *options, "--out", str(tmp_path / host)],
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
            for host in ("first", "second")
        ]
        said = [host.communicate(timeout=280)[0] for host in hosts]
        assert [host.returncode for host in hosts] == [0, 0], said
        reached = [torch.load(path, weights_only=True)["steps"] for path in tmp_path.glob("*/checkpoint.pt")]
        assert max(reached) == steps


@pytest.mark.slow
def test_a_run_goes_on_with_another_number_of_processes(tmp_path, monkeypatch, capsys):
    options = [
        "--worlds",
        "6",
        "--set",
        "rollout=3",
        "--device",
        "cpu",
        "--out",
        str(tmp_path),
        "--iterations",
    ]
    last = json.loads(launch(2, "-m", "np_training.train", *options, "2").strip().splitlines()[-1])
    assert last["processes"] == 2 and last["steps"] == 2 * 6 * 3
    monkeypatch.setattr("sys.argv", ["train", *options, "1"])
    train.main()
    last = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert last["processes"] == 1 and last["steps"] == 3 * 6 * 3
    rows = list(csv.DictReader((tmp_path / "log.csv").open()))
    assert [row["iteration"] for row in rows] == ["1", "2", "3"]


def test_alone_a_sum_is_the_number_itself():
    tensor = torch.tensor([1.0, 2.0])
    distributed.add(tensor)
    assert tensor.tolist() == [1.0, 2.0] and distributed.rank() == 0 and distributed.size() == 1
    assert distributed.total({"a": 2, "b": tensor.sum()}, torch.device("cpu")) == {"a": 2.0, "b": 3.0}
    assert distributed.any_of(True, torch.device("cpu")) and not distributed.any_of(False, torch.device("cpu"))
