"""A run of the training: what it goes on from, what is left of its time, when a stage is over, and what it writes."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from torch import nn

from np_training import train
from np_training.checkpoints import CheckpointError
from np_training.environment.config import EnvironmentConfig
from np_training.ppo import training
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
        self.environment = SimpleNamespace(config=EnvironmentConfig(), device=torch.device("cpu"))
        self.steps, self.seconds, self.stage_begun, self.saved = 0, 0.0, 0, []
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
    assert written["ppo"]["clip"] == 0.2 and written["train"]["rollout"] == 12 and written["environment"]["reward"]


@pytest.mark.parametrize("name, theirs", [("object", "wood"), ("max_opening", 0.04)])
def test_a_found_checkpoint_of_another_object_is_refused_and_a_named_one_is_not(name, theirs):
    trainer = SimpleNamespace(setting=SETTING)
    other = {"setting": {**SETTING, name: theirs}}
    training.check_same_run({"setting": SETTING}, trainer, Path("checkpoint.pt"))
    training.check_same_run(other, trainer, None)
    with pytest.raises(CheckpointError, match="checkpoint.pt: expected a checkpoint of .*name another --out"):
        training.check_same_run(other, trainer, Path("checkpoint.pt"))


def kept(path, steps):
    """A checkpoint of so many steps, in the second stage of a recipe."""
    path.parent.mkdir(exist_ok=True)
    state = {"networks": {}, "steps": steps, "recipe_stage": 1, "stage_begun": 3}
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


def test_forces_of_ended_episodes_have_a_median_a_quantile_and_a_largest():
    assert force_figures(torch.zeros(0)) == {}
    figures = force_figures(torch.arange(101.0))
    assert figures == pytest.approx({"force_median": 50, "force_q99": 99, "force_max": 100})
