"""Reports, comparisons and releases of runs: what they say is what the log and the evaluations say."""

import json

import cv2
import numpy as np
import pytest
import torch

from np_description.domains import BUMP, CARD
from np_description.weights.header import read_metadata, tensors_sha256
from np_policy.contract import POST_CONTACT, PRE_CONTACT, PolicyContract
from np_policy.networks import PostContactNetwork, PreContactNetwork
from np_policy.weights import WeightsError, load, save, sha256
from np_training.episodes.evaluation import rate, read_checkpoint
from np_training.ppo.config import PPOConfig
from np_training.ppo.learner import Learner
from np_training.ppo.log import TrainingLog, read_log
from np_training.ppo.networks import ActorCritic
from np_training.report import read_run, write_report
from np_training.reports.curves import WINDOW, find_success
from np_training.reports.releasing import check_releasable, figure_table, release

EVALUATION = {
    "conditions": "twice",
    "student": False,
    "domain": "bump",
    **rate(np.arange(100) < 91),
    "infeasible": 1,
    "broken": 0,
    "lost": 3,
    "timeout": 5,
    "by_group": {"tips1": rate(np.arange(40) < 30)},
    "one_at_a_time": {"mass": rate(np.arange(100) < 80)},
    "breaks_first": "mass",
    "over_velocity_limit": {"largest_joint_share": 0.01},
    "over_torque_limit": {"largest_joint_share": 0.0},
    "failures": {
        "lost": {"episodes": 3, "median_end_distance_mm": 210.0, "median_end_angle_rad": 1.5},
        "infeasible": {"episodes": 1},
    },
}


@pytest.fixture
def folder(tmp_path):
    """A run of 40 iterations whose success rises to 1, as train and evaluate leave it."""
    path = tmp_path / "bump"
    path.mkdir()
    log = TrainingLog(path / "log.csv")
    for k in range(1, 41):
        log.write(
            {
                "iteration": k,
                "steps": 1000 * k,
                "stage": k // 10,
                "success": min(k / 20, 1.0),
                "success_tips1": 0.5,
                "reward_progress": 0.1,
                "reward_gains": -0.01,
                "lost": 0.1,
                "length": 50.0,
                "end_distance": 0.02,
                "end_angle": 0.1,
                "pre_feasible": 0.9,
                "practice": 0.1,
                "std": 0.3,
                "pre_std": 0.2,
                "lr": 1e-3,
                "kl": 0.01,
                "value_loss": 1.0,
                "steps_per_second": 5e4,
                "elapsed": 2.0 * k,
            }
        )
    (path / "config.json").write_text(
        json.dumps(
            {
                "command": ["train.py", "--domain", "bump", "--out", "my run"],
                "device": "<GPU>",
                "processes": 2,
                "setting": {"domain": "bump", "object": "dense"},
                "environment": {"seed": 7, "physics": {"substeps": 20}},
            }
        )
    )
    (path / "evaluation.jsonl").write_text(json.dumps(EVALUATION) + "\n")
    torch.manual_seed(0)
    setting = {"domain": "bump", "limit": 150, "contact": "hard"}
    networks = ActorCritic()
    learners = {
        "post": Learner(networks.post, networks.post_value, PPOConfig(), rate=7e-5).state_dict(),
        "pre": Learner(networks.pre, networks.pre_value, PPOConfig(), rate=9e-5).state_dict(),
    }
    torch.save(
        {"networks": networks.state_dict(), "steps": 40_000, "setting": setting, **learners}, path / "checkpoint.pt"
    )
    return path


def test_a_success_counts_as_reached_once_it_lasts(folder):
    rows = read_log(folder / "log.csv")
    when = find_success(rows, 0.95)
    window = [min(k / 20, 1.0) for k in range(1, 41)]
    expected = next(k for k in range(WINDOW, 41) if np.mean(window[k - WINDOW : k]) >= 0.95)
    assert when == {"steps": 1000 * expected, "seconds": 2.0 * expected, "stage": expected // 10}
    assert find_success(rows, 1.01) is None and find_success(rows[:3], 0.0) is None


def test_the_report_says_what_the_run_did(folder):
    writer = cv2.VideoWriter(
        str(folder / "bump_0001_lost.webm"), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"VP80"), 10, (64, 64)
    )
    writer.write(np.zeros((64, 64, 3), np.uint8))
    writer.release()
    write_report(read_run(folder), folder / "report.html")
    text = (folder / "report.html").read_text()
    for part in (
        "2 x &lt;GPU&gt;",
        "<svg",
        "0.910",
        "1 quarter turn over",
        "twice the mass alone",
        "210.0 mm",
        "failed: infeasible",
        "bump_0001_lost",
        "data:video/webm;base64,",
        '<td class="name">object</td><td class="number">dense</td>',
        "lost 3",
        "10000,",
    ):
        assert part in text, part


def test_a_folder_without_a_log_is_refused(tmp_path):
    with pytest.raises(ValueError, match="expected log.csv with a row, found no log"):
        read_run(tmp_path)
    (tmp_path / "log.csv").write_text("")
    with pytest.raises(ValueError, match="found none in it"):
        read_run(tmp_path)


def test_a_release_has_the_weights_of_the_run_and_its_figures(folder, tmp_path):
    student = PreContactNetwork()
    metadata = {"domain": "bump", "sizes": "0.8 1.2"}
    save(student, tmp_path / "student.safetensors", PolicyContract.of(PRE_CONTACT, BUMP), metadata)
    state = torch.load(folder / "checkpoint.pt", weights_only=True)
    files = release(
        read_run(folder),
        state,
        tmp_path / "student.safetensors",
        tmp_path / "weights",
        tmp_path / "results",
        "2 x GPU",
        "python -m np_training.train --domain bump",
    )
    assert [file.name for file in files] == ["post_contact_bump.safetensors", "pre_contact_bump.safetensors"]
    assert [read_metadata(file).get("sizes") for file in files] == [None, "0.8 1.2"]
    post = load(PostContactNetwork(), files[0], PolicyContract.of(POST_CONTACT, BUMP)).state_dict()
    assert all(torch.equal(post[name], state["networks"][f"post.{name}"]) for name in post)
    card = files[0].with_suffix(".md").read_text()
    for part in (
        sha256(files[0]),
        tensors_sha256(files[0]),
        "seed 7",
        "0.910",
        "What breaks first: mass",
        "velocity 1.0000%",
        "tips1 0.750 (40)",
    ):
        assert part in card, part
    networks, setting, steps = read_checkpoint(tmp_path / "weights" / "training_bump.pt")
    assert setting["limit"] == 150 and steps == 40_000
    assert all(torch.equal(value, state["networks"][name]) for name, value in networks.state_dict().items())
    record = json.loads((tmp_path / "results" / "training_bump.json").read_text())
    assert record["physics_steps"] == 800_000 and record["evaluations"] == [EVALUATION]
    assert (tmp_path / "results" / "training_bump.png").exists() and (
        tmp_path / "results" / "training_bump.csv"
    ).exists()


def test_a_checkpoint_that_was_released_can_be_released_again(folder, tmp_path):
    """It has learning rates in place of optimisers, which a release does not need: it leaves them out itself."""
    save(PreContactNetwork(), tmp_path / "student.safetensors", PolicyContract.of(PRE_CONTACT, BUMP))
    state = torch.load(folder / "checkpoint.pt", weights_only=True)
    for name in ("first", "second"):
        folders = tmp_path / name, tmp_path / "results"
        release(read_run(folder), state, tmp_path / "student.safetensors", *folders, "GPU", "train")
        state = torch.load(tmp_path / name / "training_bump.pt", weights_only=True)
        assert state["post"] == pytest.approx({"rate": 7e-5}) and state["pre"] == pytest.approx({"rate": 9e-5})


def test_a_student_of_another_task_is_not_released(folder, tmp_path):
    save(PreContactNetwork(), tmp_path / "student.safetensors", PolicyContract.of(PRE_CONTACT, CARD))
    state, folders = (
        torch.load(folder / "checkpoint.pt", weights_only=True),
        (tmp_path / "weights", tmp_path / "results"),
    )
    with pytest.raises(WeightsError, match="domain: expected bump, got card"):
        release(read_run(folder), state, tmp_path / "student.safetensors", *folders, "GPU", "train")
    assert not any(path.exists() for path in folders)


def test_what_the_nodes_cannot_deploy_is_not_released():
    with pytest.raises(ValueError, match="expected evaluations in hard contacts.* got steady"):
        check_releasable({"domain": "bump", "contact": "steady"}, [EVALUATION])
    check_releasable({"domain": "bump", "contact": "steady"}, [EVALUATION, EVALUATION | {"contact": "hard"}])
    with pytest.raises(ValueError, match="expected evaluation.jsonl"):
        check_releasable({"domain": "bump", "contact": "hard"}, [])
    with pytest.raises(ValueError, match="expected evaluations of wall, got some of bump"):
        check_releasable({"domain": "wall", "contact": "hard"}, [EVALUATION])


def test_evaluations_of_the_first_version_still_make_a_table():
    old = {
        "conditions": "nominal",
        "student": True,
        "success": 0.995,
        "ci95": [0.988, 0.998],
        "episodes": 1000,
        "infeasible": 0,
        "lost": 0,
        "timeout": 5,
    }
    row = "| nominal | - | student | 0.995 | 0.988 to 0.998 | 1000 | 0 | 0 | - | 5 | - |"
    assert figure_table([old]).splitlines()[-1] == row


def test_the_curve_of_a_long_run_is_thinned_evenly(folder, tmp_path, monkeypatch):
    save(PreContactNetwork(), tmp_path / "student.safetensors", PolicyContract.of(PRE_CONTACT, BUMP))
    rows = (folder / "log.csv").read_text().splitlines()
    monkeypatch.setattr("np_training.reports.releasing.ROWS", (len(rows) - 1) // 2)
    state = torch.load(folder / "checkpoint.pt", weights_only=True)
    release(read_run(folder), state, tmp_path / "student.safetensors", tmp_path / "w", tmp_path / "r", "GPU", "train")
    kept = (tmp_path / "r" / "training_bump.csv").read_text().splitlines()
    assert len(rows) > 3 and kept[:2] == rows[:2] and len(kept) - 1 <= (len(rows) - 1) // 2 and set(kept) <= set(rows)
