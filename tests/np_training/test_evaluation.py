"""Evaluation of policies: every episode counted once, what breaks first, recordings and videos."""

import json

import cv2
import numpy as np
import pytest
import torch

from np_description.contact.depths import DepthHistogram
from np_description.domains import BUMP, DOMAINS, find_domain
from np_policy.contract import POST_CONTACT, damping_floor, weights_file
from np_training import evaluate as command
from np_training.environment.config import EnvironmentConfig
from np_training.environment.environment import Environment
from np_training.episodes.drawing import draw_recording
from np_training.episodes.episodes import MODES, Episodes, concatenate, run_episodes
from np_training.episodes.evaluation import load_released_networks, rate, summarise
from np_training.episodes.recording import load_recording
from np_training.ppo.networks import ActorCritic
from np_training.tasks.randomisation import NOMINAL_CONDITIONS, PAPER, ROBUST

WORLDS = 8


@pytest.fixture(scope="module")
def environment() -> Environment:
    return Environment(BUMP, "cpu", EnvironmentConfig(worlds=WORLDS, limit=3))


def make_episodes(modes: list[str], over: float = 0.0) -> Episodes:
    n = len(modes)
    return Episodes(
        np.array([MODES.index(m) for m in modes]),
        np.full(n, 10.0),
        np.linspace(0.01, 0.2, n),
        np.zeros(n),
        np.full((2, n, 7), over),
        np.full((3, n, 7), 0.5),
        DepthHistogram(),
        np.linspace(0.0, 1.0, n),
        np.stack([np.linspace(0.0, 50.0, n)] * 5),
        np.stack([np.full(n, 8.0), np.full(n, 2.0)]),
        {"tips0": np.arange(n) % 2 == 0, "tips1": np.arange(n) % 2 == 1},
        np.zeros((n, 7)),
    )


def test_figures_count_every_episode_once():
    figures = summarise(
        make_episodes(["success", "lost", "timeout", "infeasible", "success", "lost"], over=2.0), substeps=20
    )
    assert figures["episodes"] == 6 and figures["success"] == pytest.approx(1 / 3)
    assert figures["success"] * 6 + sum(figures[mode] for mode in MODES[1:]) == pytest.approx(6)
    assert figures["by_group"]["tips0"] == rate(np.array([True, False, True]))
    assert figures["over_torque_limit"]["largest_joint_share"] == pytest.approx(2 / (10 * 20))
    assert (
        figures["failures"]["lost"]["episodes"] == 2
        and "median_end_distance_mm" not in figures["failures"]["infeasible"]
    )
    assert figures["force"]["bare_share"] == 0.25 and figures["force"]["over_25_n"] == 2
    assert figures["force"]["filtered_n"]["largest"] == 50.0
    assert json.loads(json.dumps(figures)) == figures
    none = summarise(make_episodes(["infeasible"] * 3), substeps=20)
    assert none["success"] == 0 and none["mean_steps_to_success"] is None
    assert len(concatenate([make_episodes(["lost"]), make_episodes(["success", "timeout"])])) == 3


def test_an_evaluation_can_be_repeated_and_leaves_no_trace(environment):
    torch.manual_seed(0)
    networks = ActorCritic()
    first = run_episodes(environment, networks, networks.pre, conditions=NOMINAL_CONDITIONS, seed=3)
    run_episodes(environment, networks, networks.pre, conditions=PAPER, seed=4)
    assert environment.physics.varied.mass[:, environment.physics.varied.object_body].unique().numel() > 1
    again = run_episodes(environment, networks, networks.pre, conditions=NOMINAL_CONDITIONS, seed=3)
    np.testing.assert_allclose(again.distance, first.distance, atol=1e-4)
    assert (again.mode == first.mode).all()
    assert environment.physics.varied.mass[:, environment.physics.varied.object_body].unique().numel() == 1


@pytest.mark.slow
def test_light_objects_are_drawn_evenly_in_the_logarithm_of_their_mass(environment):
    networks, drawn = ActorCritic(), []
    for seed in range(10):
        run_episodes(environment, networks, networks.pre, conditions=ROBUST, seed=seed)
        drawn.append(environment.draws.factors[:, 2].log())
    drawn, (low, high) = torch.cat(drawn), np.log(ROBUST.mass)
    assert low <= drawn.min() and drawn.max() <= high
    assert drawn.mean().item() == pytest.approx((low + high) / 2, abs=4 * (high - low) / (12 * len(drawn)) ** 0.5)


def test_the_command_reads_its_setting_from_the_checkpoint_and_draws(tmp_path, monkeypatch, capsys):
    torch.manual_seed(0)
    setting = {"domain": "bump", "limit": 3}
    torch.save({"networks": ActorCritic().state_dict(), "steps": 7, "setting": setting}, tmp_path / "checkpoint.pt")
    monkeypatch.setattr(
        "sys.argv",
        [
            "evaluate",
            "--checkpoint",
            str(tmp_path / "checkpoint.pt"),
            "--episodes",
            "4",
            "--conditions",
            "nominal",
            "paper",
            "--seeds",
            "5",
            "--device",
            "cpu",
            "--out",
            str(tmp_path / "lines.jsonl"),
            "--record",
            str(tmp_path / "episodes.npz"),
            "--video",
            "2",
        ],
    )
    command.main()
    printed = capsys.readouterr().out.strip().splitlines()[-1]
    lines = [json.loads(line) for line in (tmp_path / "lines.jsonl").read_text().splitlines()]
    assert json.loads(printed) == lines[-1]
    assert [line["conditions"] for line in lines] == ["nominal", "paper"]
    assert all(line[name] == value for line in lines for name, value in setting.items())
    recording = load_recording(tmp_path / "episodes.npz")
    assert recording.qpos.shape == (4, 4, 16) and recording.domain == "bump"
    videos = sorted(tmp_path.glob("*.webm"))
    assert len(videos) == 2
    reader = cv2.VideoCapture(str(videos[0]))
    good, frame = reader.read()
    assert good and frame.std() > 5


def test_the_command_takes_a_rigid_object(tmp_path, monkeypatch, capsys):
    setting = {"domain": "bump", "limit": 2}
    torch.save({"networks": ActorCritic().state_dict(), "steps": 7, "setting": setting}, tmp_path / "checkpoint.pt")
    asked = [
        "evaluate",
        "--checkpoint",
        str(tmp_path / "checkpoint.pt"),
        "--episodes",
        "2",
        "--device",
        "cpu",
        "--object",
    ]
    monkeypatch.setattr("sys.argv", [*asked, "dense"])
    command.main()
    assert json.loads(capsys.readouterr().out.strip().splitlines()[-1])["object"] == "dense"
    for name, said in {"sponge": "training moves rigid ones, got sponge", "sofa": "expected one of default"}.items():
        monkeypatch.setattr("sys.argv", [*asked, name])
        with pytest.raises(SystemExit):
            command.main()
        assert f"object: {said}" in capsys.readouterr().err.splitlines()[-1]


def test_a_recording_without_an_episode_to_draw_says_so(tmp_path):
    np.savez(
        tmp_path / "none.npz",
        domain="bump",
        mode=np.array(["infeasible"]),
        length=np.zeros(1),
        goals=np.zeros((1, 7)),
        qpos=np.zeros((2, 1, 16)),
        tips=np.zeros(1),
    )
    with pytest.raises(ValueError, match="every contact was out of reach"):
        draw_recording(tmp_path / "none.npz", tmp_path, 2)
    np.savez(tmp_path / "other.npz", domain="bump")
    with pytest.raises(ValueError, match="without goals, length, mode, qpos, tips"):
        load_recording(tmp_path / "other.npz")


@pytest.mark.parametrize("domain", DOMAINS)
def test_released_weights_are_judged_with_the_damping_that_their_node_decodes(domain):
    _, setting, _ = load_released_networks(domain)
    assert setting["damping_floor"] == damping_floor(weights_file(POST_CONTACT, find_domain(domain)))
