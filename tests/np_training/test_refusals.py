"""What commands of the training refuse, in one line that says what was expected and what came, before anything is built."""

import argparse
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from np_training import distill, evaluate, report, train
from np_training.checkpoints import CheckpointError, read_state
from np_training.device import usable
from np_training.options import count, duration
from np_training.ppo.training import check_same_run


@pytest.mark.parametrize("text", ["nan", "inf", "-1", "soon", ""])
def test_a_time_that_cannot_be_is_refused(text):
    with pytest.raises(argparse.ArgumentTypeError, match=f"expected a number of at least 0, got '{text}'"):
        duration(text)
    assert duration("0") == 0 and duration("2.5") == 2.5


@pytest.mark.parametrize("text", ["0", "-3", "2.5", "many"])
def test_a_count_that_cannot_be_is_refused(text):
    with pytest.raises(argparse.ArgumentTypeError, match=f"expected a whole number of at least 1, got '{text}'"):
        count(text)
    assert count("3") == 3


def write(path, kind):
    """A file that is no checkpoint."""
    if kind == "numbers":
        np.savez(path.open("wb"), a=np.zeros(3))
    elif kind == "words":
        path.write_text("no checkpoint")
    elif kind == "nothing":
        path.write_bytes(b"")
    elif kind == "half":
        torch.save({"networks": {"a": torch.zeros(1000)}}, path)
        path.write_bytes(path.read_bytes()[:2000])
    elif kind == "another":
        torch.save({"model": {}}, path)
    return path


@pytest.mark.parametrize("kind", ["missing", "numbers", "words", "nothing", "half", "another"])
def test_a_file_that_is_no_checkpoint_is_named(tmp_path, kind):
    path = write(tmp_path / "file.pt", kind)
    with pytest.raises(CheckpointError) as refused:
        read_state(path, "cpu")
    said = str(refused.value)
    assert said.startswith(f"{path}: expected a checkpoint") and "\n" not in said and len(said) < 400
    assert {"missing": "No such file", "another": "got model"}.get(kind, "cannot read it") in said


@pytest.fixture
def refused(monkeypatch, capsys):
    """The last line that a command says of its arguments, which it refuses."""

    def ask(command, *arguments):
        monkeypatch.setattr(sys, "argv", ["command", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            command.main()
        said = ended.value.code if isinstance(ended.value.code, str) else capsys.readouterr().err
        return said.strip().splitlines()[-1]

    return ask


def test_every_command_says_so_in_a_line(tmp_path, refused):
    missing, out = tmp_path / "missing.pt", ("--out", tmp_path / "run", "--device", "cpu")
    expected = f"{missing}: expected a checkpoint of np_training.train, got: No such file or directory"
    assert refused(train, "--resume", missing, *out) == f"train: {expected}"
    assert refused(distill, "--checkpoint", missing, *out).endswith(f": {expected}; see --help")
    assert refused(evaluate, "--checkpoint", missing).endswith(f": {expected}; see --help")
    assert f": run {tmp_path}: expected log.csv" in refused(report, tmp_path)
    assert "argument --minutes: expected a number of at least 0, got 'nan'" in refused(train, "--minutes", "nan", *out)


def test_a_checkpoint_of_another_domain_is_refused_also_by_name():
    trainer = SimpleNamespace(setting={"domain": "card", "object": "default", "max_opening": 0.005})
    with pytest.raises(CheckpointError, match="expected one of the domain card, got one of wall"):
        check_same_run({"setting": {**trainer.setting, "domain": "wall"}}, trainer, None)
    check_same_run({"setting": {**trainer.setting, "object": "wood"}}, trainer, None)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there_is_refused():
    with pytest.raises(SystemExit, match="expected cpu, since PyTorch finds no GPU, got cuda:1"):
        usable("cuda:1")


def test_weights_that_are_missing_are_named(tmp_path, monkeypatch, refused):
    monkeypatch.setenv("NP_WEIGHTS", str(tmp_path))
    assert f"expected the file {tmp_path}/post_contact_wall.safetensors" in refused(evaluate, "--released", "wall")
