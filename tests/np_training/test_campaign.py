"""A campaign trains every domain through its stages, once, and goes on where it was broken off."""

import json
import subprocess

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from np_training import campaign
from np_training.campaign import RECIPES, Recipe, Stage, next_stage, shares

STAGES = (Stage("firm", 0.45), Stage("hard", 0.55))


@given(st.floats(10, 2000), st.floats(0, 2500))
def test_stages_follow_one_another_for_their_shares(seconds, trained):
    due = next_stage(STAGES, seconds, trained)
    if due is None:
        assert trained >= seconds - 1.0 - 1e-6
        return
    number, left = due
    assert left > 1.0
    assert trained + left == pytest.approx(seconds * sum(s.share for s in STAGES[: number + 1]))


def test_all_time_is_given_out():
    assert all(sum(stage.share for stage in recipe.stages) == pytest.approx(1.0) for recipe in RECIPES.values())
    assert shares(("card", "wall", "bump"), 20.0, 2) == {"card": 20.0, "wall": 10.0, "bump": 10.0}
    assert shares(("card", "wall", "bump"), 20.0, 1) == {"card": 10.0, "wall": 5.0, "bump": 5.0}


class Machine:
    """Runs nothing: a training run leaves a checkpoint that is as much older as it was asked for, times `pace`."""

    def __init__(self, pace=1.0, fails=()):
        self.commands, self.pace, self.fails = [], pace, fails

    def __call__(self, arguments, gpu):
        module = arguments[0].removeprefix("np_training.")
        given_ = {name: value for name, value in zip(arguments[1:], arguments[2:]) if name.startswith("--")}
        self.commands.append((module, given_, gpu))
        if given_.get("--domain") in self.fails:
            raise subprocess.CalledProcessError(1, arguments)
        out = campaign.Path(given_["--out"])
        if module == "train":
            before = torch.load(given_["--resume"])["seconds"] if "--resume" in given_ else 0.0
            torch.save(
                {"networks": {}, "seconds": before + self.pace * 60 * float(given_["--minutes"])},
                out / campaign.CHECKPOINT,
            )
        elif module == "distill":
            (out / f"pre_contact_student_{out.name}.safetensors").touch()
        else:
            with out.open("a") as file:
                file.write("{}\n")

    def trained(self, domain):
        return [options for module, options, _ in self.commands if module == "train" and options["--domain"] == domain]


@pytest.fixture(autouse=True)
def recipes(tmp_path, monkeypatch):
    """The card begins with nothing, the wall with a checkpoint of 1200 s."""
    torch.save({"networks": {}, "seconds": 1200.0}, tmp_path / "wall.pt")
    monkeypatch.setitem(RECIPES, "card", Recipe(2.0, STAGES, tmp_path / "none.pt"))
    monkeypatch.setitem(RECIPES, "wall", Recipe(1.0, (Stage("hard", 1.0),), tmp_path / "wall.pt"))


def test_what_is_resumed_goes_back_in_the_curriculum_once(tmp_path, monkeypatch):
    recipe = Recipe(1.0, (Stage("hard", 1.0, back_to=10),), tmp_path / "wall.pt")
    monkeypatch.setitem(RECIPES, "wall", recipe)
    machine = Machine(pace=0.5)
    campaign.campaign(["wall"], tmp_path / "out", 10.0, 50, [0], [], machine)
    stages = [options.get("--stage") for options in machine.trained("wall")]
    assert stages[0] == "10" and len(stages) > 1 and not any(stages[1:])
    monkeypatch.setitem(RECIPES, "wall", Recipe(1.0, recipe.stages, None))
    campaign.campaign(["wall"], tmp_path / "none", 10.0, 50, [0], [], begun := Machine())
    assert "--resume" not in begun.trained("wall")[0] and "--stage" not in begun.trained("wall")[0]


def test_every_domain_is_trained_distilled_and_judged(tmp_path):
    machine = Machine()
    outcome = campaign.campaign(["card", "wall"], tmp_path / "out", 10.0, 50, [0, 1], ["--worlds", "8"], machine)
    assert outcome == {"card": "done", "wall": "done"}
    first, second = machine.trained("card")
    assert (first["--contact"], float(first["--minutes"])) == ("firm", 4.5) and "--resume" not in first
    assert (second["--contact"], float(second["--minutes"])) == ("hard", 5.5) and first["--worlds"] == "8"
    (wall,) = machine.trained("wall")
    assert wall["--resume"] == str(tmp_path / "wall.pt") and float(wall["--minutes"]) == 5.0
    assert json.loads((tmp_path / "out/wall/campaign.json").read_text())["before_s"] == 1200.0
    for name in outcome:
        assert len((tmp_path / "out" / name / "evaluation.jsonl").read_text().splitlines()) == 2
    assert {gpu for _, _, gpu in machine.commands} == {0, 1}


def test_what_was_broken_off_goes_on_and_what_is_done_stays(tmp_path):
    broken = Machine(pace=0.5)
    campaign.train_domain("wall", tmp_path / "out", 400.0, [], None, broken)  # killed runs leave half the time
    asked = [float(options["--minutes"]) for options in broken.trained("wall")]
    assert asked[0] == pytest.approx(400 / 60, abs=1e-3) and asked[1] == pytest.approx(200 / 60, abs=1e-3)
    assert [options["--resume"] for options in broken.trained("wall")][1].endswith("out/wall/checkpoint.pt")
    again = Machine()
    assert campaign.campaign(["wall"], tmp_path / "out", 400 / 60, 50, [None], [], again) == {"wall": "done"}
    assert not again.trained("wall") and [module for module, *_ in again.commands] == [
        "distill",
        "evaluate",
        "evaluate",
    ]
    once_more = Machine()
    campaign.campaign(["wall"], tmp_path / "out", 400 / 60, 50, [None], [], once_more)
    assert not once_more.commands


def test_a_domain_that_fails_leaves_the_others_alone(tmp_path):
    outcome = campaign.campaign(["card", "wall"], tmp_path / "out", 10.0, 50, [0], [], Machine(fails={"card"}))
    assert "exit status 1" in outcome["card"] and outcome["wall"] == "done"


def test_a_run_that_trains_nothing_is_an_error_not_a_loop(tmp_path):
    outcome = campaign.campaign(["wall"], tmp_path / "out", 10.0, 50, [0], [], Machine(pace=0.0))
    assert "expected" in outcome["wall"] and "trained for more than 1200 s" in outcome["wall"]
