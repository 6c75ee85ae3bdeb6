"""The comparisons of the paper, each a flag of the same command, and the log of a run."""

import json
import subprocess
import sys

import pytest
import torch

from np_description.domains import BUMP, CARD, DOMAINS
from np_description.panda import NOMINAL
from np_training import train
from np_training.environment import contact
from np_training.environment.fixed_contact import FixedContact
from np_training.ppo.curriculum import STAGES, Curriculum, CurriculumConfig
from np_training.ppo.log import Log, read_log
from np_training.ppo.progress import Progress, describe
from np_training.tasks.joint_range import JointRange
from np_training.tasks.poses import sample_tasks


@pytest.mark.parametrize("start, side", [("above", (0, 0, 1)), ("right", (0, -1, 0))])
def test_a_fixed_start_is_at_its_side_of_the_object_and_in_reach(start, side):
    objects, _ = sample_tasks(BUMP, 500, torch.Generator().manual_seed(0))
    action, log_probability = FixedContact(start).act(torch.zeros(500, 18))
    contacts = contact.resolve(BUMP, action, objects)
    away = ((contacts.position - objects.position) * torch.tensor(side)).sum(-1)
    assert contacts.feasible.all() and (log_probability == 0).all()
    assert (away > BUMP.half_size[0]).all() and (away < 0.09).all()


def test_an_unknown_start_is_refused():
    with pytest.raises(ValueError, match="expected one of above, right, got 'contact'"):
        FixedContact("contact")


def test_without_the_residual_curriculum_the_first_stage_is_the_tightest():
    curriculum = Curriculum(10, CurriculumConfig(residual=False))
    assert curriculum.stage == STAGES and not curriculum.randomised
    assert not curriculum.advance(0.85, 100) and curriculum.advance(1.0, 100) and curriculum.randomised


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=DOMAINS)
def test_training_is_for_the_share_of_the_tolerance_that_the_domain_aims_at(domain, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["train", "--domain", domain.name])
    assert 0 < train.parse().tolerance == domain.aim <= 1
    monkeypatch.setattr(sys, "argv", [*sys.argv, "--tolerance", "1"])
    assert train.parse().tolerance == 1


def test_the_joint_range_tightens_with_success_and_widens_without():
    limits = JointRange(torch.device("cpu"))
    inside = torch.tensor((NOMINAL.position_lower + NOMINAL.position_upper) / 2)[None].float()
    edge = torch.tensor(NOMINAL.position_upper)[None].float()
    assert abs(limits.term(edge)) < 1e-3
    for _ in range(20):
        limits.adapt(0.99)
    assert limits.share == pytest.approx(0.99**20)
    assert limits.term(inside) == 0
    outside = (1 - limits.share) * (NOMINAL.position_upper - NOMINAL.position_lower).sum() / 2
    assert limits.term(edge).item() == pytest.approx(-limits.config.penalty * outside, rel=1e-3)
    limits.adapt(0.92)
    assert limits.share == pytest.approx(0.99**20)
    for _ in range(30):
        limits.adapt(0.1)
    assert limits.share == 1.0
    for _ in range(200):
        limits.adapt(1.0)
    assert limits.share == limits.config.least


def test_every_comparison_runs_and_says_so_in_its_checkpoint(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        "sys.argv",
        [
            "train",
            "--domain",
            "bump",
            "--worlds",
            "8",
            "--rollout",
            "3",
            "--limit",
            "4",
            "--start",
            "right",
            "--controller",
            "osc",
            "--curriculum",
            "none",
            "--adaptive-joint-range",
            "--device",
            "cpu",
            "--iterations",
            "2",
            "--out",
            str(tmp_path),
        ],
    )
    train.main()
    last = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert last["stage"] == STAGES and last["steps"] == 2 * 8 * 3
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    assert state["setting"] == {
        "domain": "bump",
        "object": "default",
        "start": "right",
        "controller": "osc",
        "limit": 4,
        "contact": "hard",
        "reward": "potentials",
        "max_opening": BUMP.max_opening,
        "largest_turn": None,
    }
    rows = read_log(tmp_path / "log.csv")
    assert len(rows) == 2 and rows[-1]["joint_range"] == 1.0 and "pre_kl" not in rows[-1]
    for group in ("tips0", "tips1", "tips2", "goal0", "goal1"):
        assert 0 <= rows[-1][f"success_{group}"] <= 1
    assert json.loads((tmp_path / "config.json").read_text())["setting"] == state["setting"]
    monkeypatch.setattr(
        "sys.argv", ["train", "--domain", "bump", "--worlds", "4", "--device", "cpu", "--out", str(tmp_path)]
    )
    with pytest.raises(SystemExit, match="expected a checkpoint of .*'start': 'contact'.* got one of .*'right'"):
        train.main()


def test_a_log_survives_a_kill_and_new_columns(tmp_path):
    path = tmp_path / "log.csv"
    log = Log(path)
    for iteration in (1, 2, 3):
        log.write({"iteration": iteration, "success": 0.1 * iteration})
    with path.open("a") as file:
        file.write("4,0.")  # killed in the middle of a row: no line end; looks like a whole row
    log = Log(path)  # resumed from a checkpoint after iteration 2
    log.write({"iteration": 3, "lost": 0.5, "success": 0.9})
    log.write({"iteration": 4, "success": 0.95})
    rows = read_log(path)
    assert [row["iteration"] for row in rows] == [1, 2, 3, 4]
    assert [row["success"] for row in rows] == pytest.approx([0.1, 0.2, 0.9, 0.95])
    assert rows[2]["lost"] == 0.5 and rows[0]["lost"] != rows[0]["lost"]
    assert len(path.read_text().splitlines()) == 1 + 3 + 2  # what the killed run logged is still there


def test_a_run_that_was_killed_goes_on_from_its_checkpoint(tmp_path, monkeypatch):
    options = [
        "--worlds",
        "4",
        "--rollout",
        "2",
        "--device",
        "cpu",
        "--out",
        str(tmp_path),
        "--save-every",
        "0",
        "--show-every",
        "0",
        "--iterations",
    ]
    with subprocess.Popen(
        [sys.executable, "-m", "np_training.train", *options, "1000"],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    ) as process:
        shown = (line for line in process.stderr if "M steps" in line)
        first, second = (
            next(shown, ""),
            next(shown, ""),
        )  # a row is logged, shown, then saved: the first was saved
        process.kill()
        process.stderr.read()
    assert "success" in first and "min left" in second
    saved = torch.load(tmp_path / "checkpoint.pt", weights_only=True)["iteration"]
    monkeypatch.setattr("sys.argv", ["train", *options, "1"])
    train.main()
    rows = read_log(tmp_path / "log.csv")
    last = torch.load(tmp_path / "checkpoint.pt", weights_only=True)["iteration"]
    assert last == saved + 1 and [row["iteration"] for row in rows][:last] == list(range(1, last + 1))


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=lambda d: d.name)
def test_progress_names_what_is_going_on(domain, capsys):
    row = {
        "steps": 2_000_000,
        "steps_per_second": 250_000.0,
        "stage": STAGES + 1,
        "success": 0.5,
        "practice": 0.2,
        "success_roll": 0.9,
        "lost": 0.1,
        "length": 30.0,
        "end_distance": 0.012,
        "end_angle": 0.2,
        "pre_feasible": 1.0,
        "std": 0.3,
        "kl": 0.01,
    }
    if domain is not CARD:
        row["success_tips1"] = 0.25
    text = describe(row, 90)
    for part in (
        "2.0 M steps",
        "250.0 k/s",
        "randomised",
        "success 0.500",
        "practice 0.20: roll 0.90",
        "1.5 min left",
    ):
        assert part in text
    assert ("tips1 0.25" in text) == (domain is not CARD)
    progress = Progress()
    for _ in range(3):
        progress.show(row, 90)
    assert capsys.readouterr().err.count("\n") == 1  # no terminal: a line a minute
