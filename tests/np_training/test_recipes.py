"""Recipes: what a file may say, how its stages follow one another, and that a killed run goes on in the stage where it was."""

import json
from pathlib import Path

import pytest
import torch

from np_description.domains import DOMAINS
from np_training import train
from np_training.finish import steps_after
from np_training.recipe import RecipeError, read_recipe
from np_training.tasks.randomisation import ROBUST, find_conditions, parse_changes

RECIPES = Path(__file__).parents[2] / "recipes"


@pytest.mark.parametrize("name", DOMAINS)
def test_every_domain_has_a_recipe_from_nothing_that_can_end(name):
    recipe = read_recipe(RECIPES / f"{name}.yaml")
    assert recipe.domain == name and all(stage.success and stage.steps < 1e6 for stage in recipe.stages)
    assert {"nominal", "paper", "stiffness 4"} <= {row.name for row in recipe.judge}
    last = recipe.stages[-1].drawn
    assert last.force_margin[0] <= 0.6 and last.force_margin[1] <= 1.0  # no further than where a robot stops
    assert last.mass[0] <= 0.1 and last.mass[1] >= 3 and last.size[0] <= 0.8 and last.size[1] >= 1.2


@pytest.mark.parametrize(
    "text, said",
    [
        ("domain: sofa", "expected distil, domain, judge"),
        ("domain: card\nsettings: {hardness: 3}", "settings: expected fields of .* got hardness"),
        ("domain: card\nsettings: {contact: jelly}", "contact: expected one of .* got 'jelly'"),
        ("domain: card\nsettings: {changes: {mass: heavy}}", "mass: expected a number or least and most, got 'heavy'"),
        ("domain: card\nsettings: {reward: {smiles: 1}}", "reward: expected fields of .* got smiles"),
        ("domain: card\nsettings: {damping_floor: 3}", "damping_floor: expected 0.5 to 2, got 3"),
    ],
)
def test_what_is_no_recipe_is_refused(text, said, tmp_path):
    (tmp_path / "recipe.yaml").write_text(text)
    with pytest.raises(RecipeError, match=said):
        read_recipe(tmp_path / "recipe.yaml")


def test_changes_of_conditions_are_read_as_they_are_written():
    assert find_conditions("robust", parse_changes(["mass=3", "size=(.9, 1)", "goal_in_image=True"])) == (
        find_conditions("robust", {"mass": (3, 3), "size": (0.9, 1), "goal_in_image": True})
    )
    assert find_conditions("robust") == ROBUST
    for wrong in ("mass", "mass=heavy"):
        with pytest.raises(ValueError, match="expected field=value"):
            parse_changes([wrong])
    with pytest.raises(ValueError, match="expected a field of .* got 'colour'"):
        find_conditions("paper", {"colour": 1})


def test_stages_follow_one_another_and_a_killed_run_goes_on_where_it_was(tmp_path, monkeypatch, capsys):
    recipe, out = tmp_path / "recipe.yaml", tmp_path / "run"
    recipe.write_text(
        "domain: bump\nsettings: {rollout: 2, limit: 4, contact: growing}\n"
        "stages:\n  - {steps: 0.000016, conditions: robust}\n  - {steps: 0.000032, kept: 0.25}\n"
    )
    options = ["--recipe", str(recipe), "--worlds", "8", "--device", "cpu", "--out", str(out), "--iterations", "1"]
    for stage, iterations, begun in ((1, 1, 16), (1, 2, 16)):
        monkeypatch.setattr("sys.argv", ["train", *options])
        train.main()
        state = torch.load(out / "checkpoint.pt", weights_only=True)
        assert (state["recipe_stage"], state["iteration"], state["stage_begun"]) == (stage, iterations, begun)
        assert not json.loads(capsys.readouterr().out.splitlines()[-1])["done"]
    left = [step[0] for _, step in steps_after(recipe, read_recipe(recipe), out, "cpu")]
    assert left == ["np_training.distill", "np_training.evaluate", "np_training.evaluate", "np_training.report"]
    (out / "pre_contact_student_bump.safetensors").touch()
    assert len(steps_after(recipe, read_recipe(recipe), out, "cpu")) == 3
