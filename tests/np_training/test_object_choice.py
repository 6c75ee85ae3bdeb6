"""Training for another object than the domain's own: chosen once, remembered by everything that comes of the run."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from np_description.domains import BUMP, DOMAINS
from np_description.objects.choice import domain_with, object_reference
from np_description.objects.table import ROWS
from np_description.weights.header import read_metadata
from np_policy.contract import PRE_CONTACT, PolicyContract, weights_file
from np_policy.networks import PreContactNetwork
from np_policy.size_generalization import read_size_range
from np_policy.weights import load
from np_training import distill, evaluate, release, train
from np_training.environment import contact
from np_training.environment.config import EnvironmentConfig
from np_training.environment.environment import Environment
from np_training.episodes.episodes import run_episodes
from np_training.ppo.distillation import Student
from np_training.ppo.networks import ActorCritic
from np_training.ppo.training import make_trainer
from np_training.reports.releasing import check_place
from np_training.setting import UNSAID, chosen, domain_of, setting_of
from np_training.tasks.poses import sample_tasks
from np_training.tasks.practice import draw_tasks
from np_training.tasks.registry import find_task

TINY = ["--worlds", "4", "--set", "rollout=2", "limit=3", "--device", "cpu", "--iterations", "1"]
FILE = "{name: my cube, domain: bump, size: [0.1, 0.1, 0.1], mass: 0.2, surface: wood}"


def run(monkeypatch, capsys, module, *options: object) -> dict:
    """The JSON that a command prints last."""
    monkeypatch.setattr(sys, "argv", [module.__name__, *map(str, options)])
    module.main()
    return json.loads(capsys.readouterr().out.strip().splitlines()[-1])


def refusal(monkeypatch, capsys, module, *options: object) -> str:
    """The last line that a command says where it refuses its command line."""
    monkeypatch.setattr(sys, "argv", [module.__name__, *map(str, options)])
    with pytest.raises(SystemExit):
        module.main()
    return capsys.readouterr().err.strip().splitlines()[-1]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.spec.domain}-{row.spec.name}")
def test_a_domain_tells_the_choice_that_it_was_made_by(row):
    assert object_reference(domain_with(row.spec.domain, row.spec.name)) == row.spec.name


def test_a_file_is_told_by_its_content(tmp_path):
    (tmp_path / "cube.yaml").write_text(FILE)
    domain = domain_with("bump", str(tmp_path / "cube.yaml"))
    text = object_reference(domain)
    (tmp_path / "cube.yaml").unlink()
    assert domain_with("bump", text) == domain and "my cube" in text
    assert all(object_reference(domain) == "default" for domain in DOMAINS.values())


def test_a_checkpoint_that_says_nothing_was_trained_with_the_cards_own_object():
    setting = setting_of({})
    assert domain_of(setting) == DOMAINS["card"]
    own = {"max_opening": BUMP.max_opening, "largest_turn": None}
    assert setting_of({"setting": {"domain": "bump"}}) == {**UNSAID, "domain": "bump", **own}
    assert chosen(setting, object=None, limit=7) == {**setting, "limit": 7}
    with pytest.raises(ValueError, match="object: expected one of default, .*, got 'dense'"):
        chosen(setting, object="dense")


@pytest.mark.slow
def test_an_object_goes_from_the_training_to_everything_that_comes_of_it(tmp_path, monkeypatch, capsys):
    folder, checkpoint = tmp_path / "run", tmp_path / "run" / "checkpoint.pt"
    (tmp_path / "cube.yaml").write_text(FILE)
    text = object_reference(domain_with("bump", str(tmp_path / "cube.yaml")))
    training = ["--domain", "bump", "--out", folder, *TINY]
    line = run(monkeypatch, capsys, train, *training, "--object", tmp_path / "cube.yaml")
    assert (line["domain"], line["object"], line["scenario"]) == ("bump", text, 0)
    (tmp_path / "cube.yaml").unlink()  # another machine has not got it
    state = torch.load(checkpoint, weights_only=True)
    assert state["setting"]["object"] == text
    assert json.loads((folder / "config.json").read_text())["setting"]["object"] == text
    with pytest.raises(SystemExit, match="expected a checkpoint of .*'object': 'default'.* got one of .*my cube"):
        run(monkeypatch, capsys, train, *training)

    line = run(
        monkeypatch,
        capsys,
        *(distill, "--checkpoint", checkpoint, "--out", folder, "--steps", 1, "--batch", 8, "--device", "cpu"),
    )
    student = Path(line["file"])
    assert line["object"] == text == read_metadata(student)["object"]

    judged = ["--checkpoint", checkpoint, "--episodes", 4, "--device", "cpu"]
    line = run(monkeypatch, capsys, evaluate, *judged, "--out", folder / "evaluation.jsonl", "--scenario", 2)
    assert (line["object"], line["scenario"]) == (text, 2)
    line = run(monkeypatch, capsys, evaluate, *judged, "--object", "default")
    assert (line["object"], line["scenario"]) == ("default", 0)

    monkeypatch.chdir(tmp_path)
    releasing = [folder, "--student", student]
    said = refusal(monkeypatch, capsys, release, *releasing)
    assert "expected --weights FOLDER, another than weights, for object" in said and "my cube" in said
    assert not (tmp_path / "weights").exists()
    said = refusal(monkeypatch, capsys, release, *releasing, "--object", "default")
    assert "expected evaluations with object default, got some with" in said
    line = run(monkeypatch, capsys, release, *releasing, "--weights", "weights_cube")
    assert line["object"] == text and {Path(file).parent.name for file in line["files"]} == {"weights_cube"}
    for file in map(Path, line["files"]):
        assert read_metadata(file)["object"] == text and f"| object | {text} |" in file.with_suffix(".md").read_text()
    record = json.loads((tmp_path / "weights_cube" / "training_bump.json").read_text())
    assert record["object"] == text


@pytest.mark.slow
def test_a_student_for_another_object_is_not_released(tmp_path, monkeypatch, capsys):
    folder, checkpoint = tmp_path / "run", tmp_path / "run" / "checkpoint.pt"
    run(monkeypatch, capsys, train, "--domain", "bump", "--object", "dense", "--out", folder, *TINY)
    run(
        monkeypatch, capsys, evaluate, "--checkpoint", checkpoint, "--episodes", 2, "--out", folder / "evaluation.jsonl"
    )
    tiny = ["--steps", 1, "--batch", 8, "--device", "cpu"]
    line = run(
        monkeypatch, capsys, distill, "--checkpoint", checkpoint, "--object", "wood", "--out", tmp_path / "wood", *tiny
    )
    said = refusal(monkeypatch, capsys, release, folder, "--student", line["file"], "--weights", tmp_path / "dense")
    assert "expected a student for object dense, got one for wood" in said
    assert not (tmp_path / "dense").exists()


def test_the_folder_that_the_nodes_load_from_is_not_for_another_object(tmp_path, monkeypatch):
    monkeypatch.setenv("NP_WEIGHTS", str(tmp_path))
    with pytest.raises(ValueError, match="from there the nodes load the weights for the domain's own object"):
        check_place("dense", tmp_path)
    check_place("dense", tmp_path / "dense")
    check_place("default", tmp_path)


@pytest.mark.parametrize(
    "module, needed", [(train, ()), (distill, ("--out", "x", "--checkpoint"))], ids=["train", "distill"]
)
def test_an_object_that_cannot_be_trained_with_is_refused_in_a_line(module, needed, tmp_path, monkeypatch, capsys):
    if needed:
        torch.save({"networks": ActorCritic().state_dict(), "setting": {"domain": "bump"}}, tmp_path / "checkpoint.pt")
        needed = (*needed, tmp_path / "checkpoint.pt")
    for name, said in {"sponge": "training moves rigid ones, got sponge", "sofa": "expected one of default"}.items():
        line = refusal(monkeypatch, capsys, module, "--domain", "bump", "--object", name, *needed)
        assert f"object: {said}" in line


def test_what_is_trained_with_weighs_what_the_object_weighs(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "argv", ["train", "--domain", "bump", "--object", "dense", "--out", str(tmp_path), *TINY])
    trainer = make_trainer(train.parse(), "cpu", 0, None)
    physics = trainer.environment.physics
    assert physics.varied.mass[:, physics.varied.object_body].numpy() == pytest.approx(0.223)
    assert trainer.setting["object"] == "dense"


def test_practice_leaves_a_larger_object_the_gap_to_the_bump_that_its_own_has():
    domain = domain_with("bump", FILE)
    kinds = find_task("bump").kinds
    tasks = draw_tasks(domain, (1 / len(kinds),) * len(kinds), 4000, torch.Generator().manual_seed(7))
    edge = domain.obstacles[0].centre[1] - domain.obstacles[0].half_size[1]
    side = tasks.starts.position[:, 1] < edge - domain.half_size[1] / 2  # on the table, before the bump
    assert side.any()
    reach = 2**0.5 * domain.half_size[0]  # turned by any yaw
    assert (tasks.starts.position[side, 1] + reach < edge).all()


def test_episodes_of_a_scenario_have_its_goal_and_their_starts_scatter():
    environment = Environment(BUMP, "cpu", EnvironmentConfig(worlds=4, limit=1))
    networks = ActorCritic()
    episodes = run_episodes(environment, networks, networks.pre, seed=1, scenario=2, record=True)
    assert np.ptp(episodes.goals, axis=0).max() == 0
    starts = episodes.qpos[0, :, 9:11]
    assert 0 < np.ptp(starts, axis=0).max() < 0.005
    drawn = run_episodes(environment, networks, networks.pre, seed=1)
    assert np.ptp(drawn.goals, axis=0).max() > 0.01
    with pytest.raises(ValueError, match="scenario: expected 1 to 3, got 4"):
        run_episodes(environment, networks, networks.pre, seed=1, scenario=4)


@pytest.mark.parametrize("domain, factor", [("bump", 1.2), ("wall", 1.1), ("wall", 0.8)])
def test_a_student_reaches_an_object_of_another_size_where_the_network_alone_would_not(domain, factor):
    """Of the released weights; where the object is smaller, the network alone stands too far off. One that was trained with a range of
    sizes needs no help: what it is told of the size moves the contact by millimetres."""
    spec = DOMAINS[domain]
    size = [2 * factor * half for half in spec.half_size]
    text = json.dumps({"name": "other", "domain": domain, "size": size, "mass": spec.mass, "surface": "paper"})
    other = domain_with(domain, text)
    file = weights_file(PRE_CONTACT, spec)
    network = load(PreContactNetwork(), file, PolicyContract.of(PRE_CONTACT, spec))
    least, most = read_size_range(read_metadata(file))
    objects, goals = sample_tasks(other, 40, torch.Generator().manual_seed(0))
    with torch.no_grad():
        (position, *chosen), (alone, *_) = (
            Student(network, known).hand_poses(other, objects, goals) for known in ("default", text)
        )
    contacts = contact.reach(other, position, *chosen, objects)
    assert contacts.feasible.float().mean() > 0.9
    apart, reached = (
        (position - alone).norm(dim=-1),
        contact.reach(other, alone, *chosen, objects).feasible.float().mean(),
    )
    if least < most:
        assert reached > 0.9 and (apart < 0.005).all()
    else:
        assert factor < 1 or reached < 0.3
        assert (apart > 0.5 * abs(factor - 1) * min(size)).all() and (apart < 0.03).all()
