"""Training of the policies, tiny, on the CPU: the same code as on a GPU."""

import csv
import dataclasses
import json

import numpy as np
import pytest
import torch

from np_common.rotations import quaternion_from_matrix, rotation_angle
from np_control.impedance import torque
from np_description.domains import BUMP, CARD
from np_description.panda import NOMINAL
from np_policy.networks import PreContactNetwork
from np_training import train
from np_training.environment import contact
from np_training.environment.config import EnvironmentConfig
from np_training.environment.environment import Environment
from np_training.environment.object_poses import pre_contact_state
from np_training.episodes.evaluation import evaluate
from np_training.physics.batched import BatchedPhysics
from np_training.physics.config import PhysicsConfig
from np_training.ppo.distillation import Student, distil, shares_with
from np_training.ppo.networks import ActorCritic, PreContactActor
from np_training.tasks.poses import sample_tasks
from np_training.tasks.randomisation import PAPER
from np_training.tasks.registry import find_task

WORLDS = 16


@pytest.fixture(scope="module")
def environment() -> Environment:
    """A small environment; its kernels compile once and stay in Warp's cache."""
    env = Environment(CARD, "cpu", EnvironmentConfig(worlds=WORLDS, limit=6))
    torch.manual_seed(0)
    env.starts = env.draw_starts(PreContactActor(), 128)
    env.reset(torch.arange(WORLDS))
    return env


def test_kernel_and_controller_compute_the_same_torque():
    physics = BatchedPhysics(CARD, WORLDS, "cpu", PhysicsConfig(substeps=1))
    generator = torch.Generator().manual_seed(1)
    physics.qpos[:, :7] += 0.2 * torch.randn(WORLDS, 7, generator=generator)
    physics.qvel[:, :7] = 0.5 * torch.randn(WORLDS, 7, generator=generator)
    command = physics.command
    command[0::3] = physics.qpos[:, :7] + 0.02 * torch.randn(2, WORLDS, 7, generator=generator)
    command[1::3] = 10 + 90 * torch.rand(2, WORLDS, 7, generator=generator)
    command[2::3] = 0.5 + 1.5 * torch.rand(2, WORLDS, 7, generator=generator)
    physics.delay[: WORLDS // 2] = 1  # these still follow the command of the period before
    q, dq = physics.qpos[:, :7].clone(), physics.qvel[:, :7].clone()
    bias, gravity = (
        torch.from_numpy(getattr(physics.data, name).numpy()[:, :7].copy()) for name in ("qfrc_bias", "qfrc_gravcomp")
    )
    new = (torch.arange(WORLDS) >= WORLDS // 2)[:, None]
    target, stiffness, ratio = (torch.where(new, command[i + 3], command[i]) for i in range(3))
    expected = torque(*(a.double().numpy() for a in (q, dq, target, stiffness, ratio, bias - gravity)))
    expected = np.clip(expected, -NOMINAL.torque_limit, NOMINAL.torque_limit)
    physics.applied[:] = torch.from_numpy(expected)  # the torque rate is asked of test_impedance
    physics.advance()
    assert np.abs(physics.ctrl[:, :7].numpy() - expected).max() < 1e-5


def test_a_pool_without_contacts_says_so(environment):
    environment_starts = environment.draw_starts(PreContactActor(), 16)
    nowhere = dataclasses.replace(environment_starts.contacts, feasible=torch.zeros(16, dtype=torch.bool))
    with pytest.raises(ValueError, match="at least one feasible contact among 16, found none"):
        dataclasses.replace(environment_starts, contacts=nowhere).take(3)


def test_mass_randomisation_leaves_the_object_where_it_is(environment):
    everyone = torch.arange(WORLDS)
    environment.reset(everyone)
    before = environment.objects.position.clone()
    one = torch.ones(WORLDS)
    environment.physics.varied.randomise(everyone, one, one, torch.linspace(0.7, 1.3, WORLDS))
    environment.physics.advance()
    environment.physics.varied.randomise(everyone, one, one, one)
    assert (environment.objects.position - before).norm(dim=-1).max() < 1e-3


def test_a_tighter_tolerance_asks_for_more(environment):
    before = environment.config
    environment.reset(torch.arange(WORLDS))
    goal, turn = environment.objects.position.clone(), environment.objects.quaternion.clone()
    environment.goals.position[:] = goal + torch.tensor([0.0, 0.8 * CARD.tolerance_position, 0.0])
    environment.goals.quaternion[:] = turn
    succeeded = {}
    for tolerance in (0.5, 1.0):
        environment.config = dataclasses.replace(before, tolerance=tolerance)
        environment.held[:] = 0
        still = torch.zeros(WORLDS, 20)
        succeeded[tolerance] = environment.step(still)["success"].float().mean().item()
    environment.config = before
    assert succeeded[0.5] == 0.0 and succeeded[1.0] > 0.5


def test_a_joint_beyond_its_speed_ends_the_episode_where_the_reflex_is_on(environment):
    before = environment.config
    for reflex in (False, True):
        environment.config = dataclasses.replace(before, reflex=reflex)
        environment.reset(torch.arange(WORLDS))
        environment.physics.qvel[: WORLDS // 2, 0] = 1.2 * NOMINAL.velocity_limit[0]
        out = environment.step(torch.zeros(WORLDS, 20))
        assert out["stopped"][: WORLDS // 2].all() == reflex and not out["stopped"][WORLDS // 2 :].any()
        assert out["done"][out["stopped"]].all() and not (out["stopped"] & (out["lost"] | out["timeout"])).any()
        assert (out["terms"]["failure"] < 0)[out["stopped"]].all()
    environment.config = before


def test_randomised_episodes_stay_sound(environment):
    environment.config = dataclasses.replace(environment.config, conditions=PAPER)
    environment.reset(torch.arange(WORLDS))
    for _ in range(5):
        out = environment.step(torch.randn(WORLDS, 20).clamp(-1, 1))
        assert not out["broken"].any() and torch.isfinite(out["reward"]).all()
        assert all(torch.isfinite(part).all() for part in environment.observe())
        environment.reset(out["done"].nonzero()[:, 0])


def test_training_runs_and_goes_on_where_it_stopped(tmp_path, monkeypatch, capsys):
    command = ["train", "--worlds", "8", "--set", "rollout=3", "--device", "cpu", "--out", str(tmp_path)]
    for iterations, total in ((2, 2), (1, 3)):
        monkeypatch.setattr("sys.argv", [*command, "--iterations", str(iterations)])
        train.main()
        last = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
        assert last["steps"] == total * 8 * 3
    rows = list(csv.DictReader((tmp_path / "log.csv").open()))
    assert [row["iteration"] for row in rows] == ["1", "2", "3"]
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    fresh = ActorCritic()
    fresh.load_state_dict(state["networks"])
    assert state["iteration"] == 3


def test_distillation_brings_the_student_to_the_teacher():
    torch.manual_seed(5)
    teacher = PreContactActor()
    _, start = distil(CARD, teacher, "cpu", minutes=0, batch=256, steps=5)
    student, end = distil(CARD, teacher, "cpu", minutes=0, batch=256, steps=100)
    assert end["position_mm"] < 0.6 * start["position_mm"]
    starts, goals = sample_tasks(CARD, 2000, torch.Generator().manual_seed(6))
    with torch.no_grad():
        chosen = contact.contact_pose(CARD, teacher(pre_contact_state(starts, goals)), starts)
        position, rotation, width = Student(student).hand_poses(CARD, starts, goals)
    angle = rotation_angle(*(quaternion_from_matrix(matrix) for matrix in (rotation, chosen[1])))
    assert end["position_mm"] == pytest.approx(1e3 * (position - chosen[0]).norm(dim=-1).mean().item(), rel=0.15)
    assert end["width_mm"] == pytest.approx(1e3 * (width - chosen[2]).abs().mean().item(), rel=0.15)
    assert end["angle_rad"] == pytest.approx(angle.mean().item(), rel=0.15)
    assert end["median_angle_rad"] == pytest.approx(angle.median().item(), rel=0.15)
    assert end["steps"] == 100


def test_practice_of_a_student_sinks_no_obstacle():
    shares = shares_with(BUMP, 0.4)
    assert sum(shares) == pytest.approx(1.0) and shares[0] == pytest.approx(0.6)
    kinds = find_task("bump").kinds
    assert {kind.name for kind, share in zip(kinds, shares) if share} == {
        "own",
        "roll1",
        "roll2",
        "roll3",
        "turn2",
        "correct",
        "again",
    }
    assert shares_with(CARD, 0.4) == (1.0,)  # which has no practice
    assert shares_with(BUMP, 0.0) == (1.0,) + (0.0,) * (len(kinds) - 1)


@pytest.mark.slow
def test_a_student_may_learn_of_practice():
    torch.manual_seed(6)
    teacher = PreContactActor()
    _, start = distil(BUMP, teacher, "cpu", minutes=0, batch=128, steps=5, practice=0.4)
    _, end = distil(BUMP, teacher, "cpu", minutes=0, batch=128, steps=400, practice=0.4)
    assert end["position_mm"] < 0.6 * start["position_mm"]


def test_evaluation_counts_every_episode(environment):
    environment.config = dataclasses.replace(environment.config, limit=3)
    figures = evaluate(environment, ActorCritic(), Student(PreContactNetwork()))
    assert figures["episodes"] == WORLDS
    assert (
        round(figures["success"] * WORLDS)
        + figures["infeasible"]
        + figures["lost"]
        + figures["stopped"]
        + figures["timeout"]
        == WORLDS
    )
