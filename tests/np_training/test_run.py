"""A run of the training: what it goes on from, what is left of its time, when a stage is over, and what it writes."""

import io
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from torch import nn

from np_training import train
from np_training.checkpoints import CheckpointError
from np_training.environment.config import EnvironmentConfig
from np_training.ppo import distributed, training
from np_training.ppo.config import PPOConfig, TrainConfig
from np_training.ppo.curriculum import CurriculumConfig
from np_training.ppo.log import read_log
from np_training.ppo.trainer import _force_figures as force_figures
from np_training.tasks.randomisation import ROBUST

SETTING = {"domain": "card", "object": "default", "max_opening": 0.005}


class Counting:
    """A trainer that makes 10 steps an iteration, in so many seconds of the clock, and learns nothing."""

    def __init__(self, clock, seconds=2.0):
        self.networks, self.setting, self.config, self.ppo = nn.Linear(1, 1), SETTING, TrainConfig(), PPOConfig()
        physics = SimpleNamespace(overflow=lambda: {"contacts": 0})
        self.environment = SimpleNamespace(config=EnvironmentConfig(), device=torch.device("cpu"), physics=physics)
        self.curriculum = SimpleNamespace(stage=4)
        self.steps, self.seconds, self.stage_begun, self.saved, self.gone_back = 0, 0.0, 0, [], []
        self._clock, self._took = clock, seconds

    def iterate(self):
        self._clock.now += self._took
        self.steps += 10
        names = "success lost length end_distance end_angle pre_feasible std kl stage".split()
        return {"iteration": self.steps // 10, "steps": self.steps} | dict.fromkeys(names, 0)

    def is_over(self, success, steps):
        return self.steps - self.stage_begun >= steps

    def save(self, path):
        self.saved.append((self.steps, path.name))

    def begin_stage(self, number):
        self.stage_begun = self.steps

    def go_back(self, stage):
        self.gone_back.append(stage)

    def state_dict(self):
        return {"steps": self.steps}


@pytest.fixture
def clock(monkeypatch):
    """Time that stands still but where a test moves it."""
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(training.time, "monotonic", lambda: clock.now)
    return clock


def options(folder, **changes):
    """What the command line gives."""
    stage = SimpleNamespace(success=None, steps=1.0)
    given = {
        "out": folder,
        "minutes": 1.0,
        "iterations": 100,
        "from_first": False,
        "stage": None,
        "show_every": 0.0,
        "save_every": 1e9,
    }
    return SimpleNamespace(**(given | {"stages": [stage], "resume": None} | changes))


def test_what_is_left_is_the_time_or_the_iterations_whichever_ends_first(clock):
    counted = training.Clock(options(None, minutes=2.0, iterations=3))
    clock.now += 30
    assert counted.count(5.0) == 2 * 5.0
    clock.now += 85
    assert counted.count(50.0) == pytest.approx(120 - 115)
    clock.now -= 85
    assert counted.count(5.0) == 0, "there is no iteration left"


def test_time_may_count_from_the_end_of_the_first_iteration(clock):
    counted = training.Clock(options(None, from_first=True))
    clock.now += 500
    assert counted.count(500.0) == 60
    clock.now += 10
    assert counted.count(10.0) == 50


def test_a_stage_ends_with_its_steps_and_a_call_with_its_iterations(clock, tmp_path, capsys):
    for iterations, steps, ended in (
        (2, 100, (20, False, True)),
        (100, 30, (30, True, False)),
        (3, 30, (30, True, True)),
    ):
        trainer, arguments = Counting(clock), options(tmp_path, iterations=iterations)
        arguments.stages[0].steps = steps / 1e6
        row, over, spent = training.train_stage(trainer, arguments, 0, training.Clock(arguments))
        assert (trainer.steps, over, spent) == ended
        assert trainer.saved == [(trainer.steps, "checkpoint.pt")]
        assert row["steps_per_second"] == pytest.approx(5.0) and row["elapsed"] == trainer.seconds == trainer.steps / 5
    assert capsys.readouterr().err.count("kernels ready after 2 s, with the first iteration") == 3


def test_a_stage_logs_every_iteration_saves_in_between_and_shows_what_is_left(clock, tmp_path, capsys):
    trainer, arguments = Counting(clock, 20.0), options(tmp_path / "run", minutes=10.0, save_every=40.0)
    trainer.steps = trainer.stage_begun = 1000
    arguments.stages[0].steps = 50e-6
    training.train_stage(trainer, arguments, 0, training.Clock(arguments))
    assert [row["elapsed"] for row in read_log(tmp_path / "run/log.csv")] == [20, 40, 60, 80, 100]
    assert [row["recipe_stage"] for row in read_log(tmp_path / "run/log.csv")] == [0] * 5
    assert [steps for steps, _ in trainer.saved] == [1020, 1040, 1050]
    shown = [line.split("  ")[-1] for line in capsys.readouterr().err.splitlines() if "M steps" in line]
    assert shown == [f"{left} min left" for left in ("1.3", "1.0", "0.7", "0.3", "0.0")]


def shown_minutes(error):
    """What lines of the progress on standard error end with."""
    return [line.split("  ")[-1].removesuffix(" min left") for line in error.splitlines() if "M steps" in line]


def test_time_left_is_that_of_the_iterations_where_these_end_first(clock, tmp_path, capsys):
    trainer, arguments = Counting(clock, 60.0), options(tmp_path, minutes=10.0, iterations=3)
    training.train_stage(trainer, arguments, 0, training.Clock(arguments))
    assert shown_minutes(capsys.readouterr().err) == ["2.0", "1.0", "0.0"]


def test_time_left_is_never_less_than_none(clock, tmp_path, capsys):
    trainer, arguments = Counting(clock, 60.0), options(tmp_path, minutes=1.5)
    training.train_stage(trainer, arguments, 0, training.Clock(arguments))
    assert shown_minutes(capsys.readouterr().err) == ["0.5", "0.0"]


def test_a_call_goes_on_while_half_a_second_is_left(clock, tmp_path):
    trainer, arguments = Counting(clock, 2.0), options(tmp_path, minutes=2.5 / 60)
    assert training.train_stage(trainer, arguments, 0, training.Clock(arguments))[2]
    assert trainer.steps == 20


@pytest.mark.parametrize("rank", [0, 1])
def test_the_first_process_alone_writes_and_all_compare_their_networks_at_both_ends(
    rank, clock, tmp_path, monkeypatch, capsys
):
    trainer, arguments, compared = Counting(clock), options(tmp_path / "run", iterations=3), []
    monkeypatch.setattr(distributed, "rank", lambda: rank)
    monkeypatch.setattr(
        distributed, "check_same", lambda networks: compared.append((networks is trainer.networks, trainer.steps))
    )
    training.train_stage(trainer, arguments, 0, training.Clock(arguments))
    assert compared == [(True, 0), (True, 30)]
    written = sorted(path.name for path in tmp_path.rglob("*"))
    assert written == ([] if rank else ["config.json", "log.csv", "run"]) and bool(trainer.saved) == (rank == 0)
    assert bool(capsys.readouterr().err) == (rank == 0)


def test_a_terminals_line_is_left_when_a_stage_ends(clock, tmp_path, monkeypatch):
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", terminal)
    arguments = options(tmp_path, iterations=2)
    training.train_stage(Counting(clock), arguments, 0, training.Clock(arguments))
    assert terminal.getvalue().count("\r") == 2 and terminal.getvalue().endswith("min left\n")


def test_every_setting_reaches_what_it_is_a_setting_of(monkeypatch):
    given = (
        "limit=7 rollout=3 stiffness=0.5 deviation=0.2 tolerance=0.4 hold=9 residual=False growth=4 practice=0.3 "
        "explore=0.6 kept=0.1 entropy=0.25 discount=0.5 target_kl=0.125 rate_limit=0.002 damping_floor=0.75 "
        "contacts=31 constraints=99 reward={'success':3}"
    )
    command = ["train", "--domain", "bump", "--worlds", "5", "--seed", "6", "--conditions", "robust", "--set"]
    monkeypatch.setattr("sys.argv", [*command, *given.split()])
    made, loaded = [], []
    monkeypatch.setattr(training, "Environment", lambda *arguments: arguments)
    monkeypatch.setattr(
        training, "Trainer", lambda *arguments: made.append(arguments) or SimpleNamespace(load_state_dict=loaded.append)
    )
    arguments = train.parse()
    training.make_trainer(arguments, "cpu", 0, None)
    assert not loaded
    training.make_trainer(arguments, "cpu", 0, {"steps": 1})
    assert loaded == [{"steps": 1}]
    (domain, device, environment), config, ppo = made[0]
    assert (domain.name, device, environment.worlds, environment.seed, environment.limit) == ("bump", "cpu", 5, 6, 7)
    assert environment.reward.success == 3 and environment.damping_floor == 0.75
    assert (environment.physics.contacts, environment.physics.constraints) == (31, 99)
    assert environment.physics.supports and environment.physics.resizes, "robust conditions vary table and size"
    assert (config.rollout, config.stiffness, config.deviation, config.tolerance, config.hold) == (3, 0.5, 0.2, 0.4, 9)
    assert config.conditions == ROBUST
    assert config.curriculum == CurriculumConfig(residual=False, growth=4, practice=0.3, explore=0.6, kept=0.1)
    assert ppo == PPOConfig(rate=(2e-5, 0.002), entropy=0.25, discount=0.5, target_kl=0.125)


def test_what_a_report_needs_of_a_run_lies_beside_its_log(clock, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["/some/where/train.py", "--worlds", "4"])
    training.write_config(Counting(clock), tmp_path / "config.json")
    written = json.loads((tmp_path / "config.json").read_text())
    assert written["command"] == ["np_training.train", "--worlds", "4"] and written["setting"] == SETTING
    assert (written["processes"], written["device"]) == (1, "CPU")
    assert ' "processes": 1,' in (tmp_path / "config.json").read_text().splitlines(), "a line for each"
    assert written["ppo"]["clip"] == 0.2 and written["train"]["rollout"] == 12 and written["environment"]["reward"]


@pytest.mark.parametrize("name, theirs", [("object", "wood"), ("max_opening", 0.04)])
def test_a_found_checkpoint_of_another_object_is_refused_and_a_named_one_is_not(name, theirs):
    trainer = SimpleNamespace(setting=SETTING)
    other = {"setting": {**SETTING, name: theirs}}
    training.check_same_run({"setting": SETTING}, trainer, Path("checkpoint.pt"))
    training.check_same_run(other, trainer, None)
    with pytest.raises(CheckpointError, match="checkpoint.pt: expected a checkpoint of .*name another --out"):
        training.check_same_run(other, trainer, Path("checkpoint.pt"))


def kept(path, steps, **changes):
    """A checkpoint of so many steps, in the second stage of a recipe."""
    path.parent.mkdir(exist_ok=True)
    state = {"networks": {"a": torch.zeros(1)}, "steps": steps, "recipe_stage": 1, "stage_begun": 3} | changes
    torch.save(state, path)
    return path


def test_a_run_goes_on_from_its_own_checkpoint_and_begins_its_recipe_anew_with_anothers(tmp_path):
    found = training.find_state
    assert found(options(tmp_path), "cpu") == (None, None)
    other = kept(tmp_path / "other/checkpoint.pt", 70)
    state, source = found(options(tmp_path, resume=other), "cpu")
    assert source == other and (state["steps"], state["recipe_stage"], state["stage_begun"]) == (70, 0, 70)
    own = kept(tmp_path / "checkpoint.pt", 50)
    state, source = found(options(tmp_path), "cpu")
    assert source == own and (state["steps"], state["recipe_stage"], state["stage_begun"]) == (50, 1, 3)
    assert found(options(tmp_path, resume=other), "cpu")[1] == other
    state, source = found(options(tmp_path, resume=tmp_path / "other/../checkpoint.pt"), "cpu")
    assert source == own and state["recipe_stage"] == 1


def test_a_recipe_that_is_through_is_not_trained_again(tmp_path):
    own = kept(tmp_path / "checkpoint.pt", 50)
    assert training.run(options(tmp_path), "cpu") == {"checkpoint": str(own), "done": True}


@pytest.mark.parametrize("processes, device", [(1, "meta"), (2, "cpu")])
def test_a_process_alone_reads_its_checkpoint_onto_its_device_and_one_of_several_into_main_memory(
    processes, device, tmp_path, monkeypatch
):
    """From there its tensors go to the others by a message."""
    kept(tmp_path / "checkpoint.pt", 50)
    monkeypatch.setattr(distributed, "size", lambda: processes)
    monkeypatch.setattr(distributed, "furthest", lambda state, device: state)
    assert training.find_state(options(tmp_path), "meta")[0]["networks"]["a"].device.type == device


@pytest.fixture
def made(clock, monkeypatch):
    """Trainers that runs have made, with the number of their stage; one goes on at the steps of the state that it was given."""
    made = []

    def make(arguments, device, number, state):
        trainer = Counting(clock, 2.34)
        trainer.steps = trainer.stage_begun = state["steps"] if state else 0
        made.append((number, trainer))
        return trainer

    monkeypatch.setattr(training, "make_trainer", make)
    before, torch.backends.cuda.matmul.allow_tf32 = torch.backends.cuda.matmul.allow_tf32, False
    yield made
    torch.backends.cuda.matmul.allow_tf32 = before


def test_a_run_through_two_stages_goes_back_and_is_resumed_once_and_ends_with_a_line(made, tmp_path, capsys):
    other, stage = kept(tmp_path / "other/checkpoint.pt", 70), SimpleNamespace(success=None, steps=20e-6)
    line = training.run(options(tmp_path / "out", resume=other, stage=3, stages=[stage, stage]), "cpu")
    assert [(number, trainer.steps, trainer.gone_back) for number, trainer in made] == [(0, 90, [3]), (1, 110, [])]
    resumed = [text for text in capsys.readouterr().err.splitlines() if "resumed" in text]
    assert resumed == [f"resumed from {other} at 0.0 M steps, stage 4"]
    assert line.pop("steps_per_second") == pytest.approx(10 / 2.34)
    assert line == {
        "checkpoint": str(tmp_path / "out/checkpoint.pt"), "domain": "card", "object": "default", "scenario": 0,
        "done": True, "overflow": {"contacts": 0}, "processes": 1, "steps": 110, "stage": 0, "success": 0, "lost": 0,
        "wall_s": 9.4,
    }  # fmt: skip
    assert torch.backends.cuda.matmul.allow_tf32, "a GPU multiplies matrices several times faster so"


def test_a_run_whose_iterations_are_spent_ends_after_the_stage_that_they_ended(made, tmp_path, capsys):
    stage = SimpleNamespace(success=None, steps=20e-6)
    for iterations, stages, done in ((2, 1, False), (1, 1, False), (4, 2, True)):
        made.clear()
        line = training.run(options(tmp_path, iterations=iterations, stages=[stage, stage]), "cpu")
        assert (len(made), line["done"]) == (stages, done)
    assert "resumed" not in capsys.readouterr().err


def test_a_checkpoint_without_a_stage_of_a_recipe_is_in_its_first(made, tmp_path):
    torch.save({"networks": {}, "steps": 50}, tmp_path / "checkpoint.pt")
    assert training.run(options(tmp_path, iterations=1), "cpu")["steps"] == 60
    assert [number for number, _ in made] == [0]


def test_a_run_refuses_what_lies_in_its_folder_from_another_object_and_takes_what_is_named(made, tmp_path):
    other = kept(tmp_path / "other/checkpoint.pt", 70, setting={"object": "wood"}, recipe_stage=0)
    assert training.run(options(tmp_path / "new", resume=other, iterations=1), "cpu")["steps"] == 80
    with pytest.raises(CheckpointError, match="name another --out"):
        training.run(options(other.parent), "cpu")


@pytest.mark.parametrize("rank", [0, 1])
def test_the_first_process_alone_says_what_is_resumed_and_writes_the_next_stage(
    rank, made, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(distributed, "rank", lambda: rank)
    stage = SimpleNamespace(success=None, steps=20e-6)
    kept(tmp_path / "checkpoint.pt", 70, recipe_stage=0)
    training.run(options(tmp_path, stages=[stage]), "cpu")
    assert ("resumed from" in capsys.readouterr().err) == (rank == 0)
    # Once at the end of the stage, once as the beginning of the next.
    assert made[0][1].saved == ([] if rank else [(90, "checkpoint.pt")] * 2)


def test_forces_of_ended_episodes_have_a_median_a_quantile_and_a_largest():
    assert force_figures(torch.zeros(0)) == {}
    figures = force_figures(torch.arange(101.0))
    assert figures == pytest.approx({"force_median": 50, "force_q99": 99, "force_max": 100})
