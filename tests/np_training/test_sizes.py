"""Objects of .8 to 1.2 times the domain's own size, one in each world: where they lie, what they touch, what is seen of them."""

import json
import sys
from dataclasses import replace

import pytest
import torch

from np_common.rotations import matrix_from_quaternion
from np_description.domains import BUMP, WALL
from np_description.weights.header import read_metadata
from np_policy.contract import PRE_CONTACT, PolicyContract
from np_policy.networks import PreContactNetwork
from np_policy.size_generalization import read_size_range
from np_policy.weights import load
from np_training import distill, train
from np_training.environment import contact
from np_training.environment.config import EnvironmentConfig
from np_training.environment.environment import Environment
from np_training.environment.object_poses import corners, pre_contact_state
from np_training.episodes.episodes import run_episodes
from np_training.physics.batched import BatchedPhysics
from np_training.physics.config import physics_for
from np_training.ppo.distillation import Student
from np_training.ppo.networks import ActorCritic
from np_training.ppo.training import make_trainer
from np_training.tasks.poses import Poses
from np_training.tasks.practice import draw_tasks
from np_training.tasks.randomisation import NOMINAL_CONDITIONS, ROBUST
from np_training.tasks.registry import find_task

SCALES = torch.tensor([0.8, 1.0, 1.2])
EDGES = SCALES[:, None].expand(3, 3)
EVERYONE = torch.arange(3)


@pytest.mark.parametrize("domain", [BUMP, WALL], ids=lambda d: d.name)
@pytest.mark.slow
def test_objects_of_other_sizes_rest_where_their_size_lets_them(domain):
    """On the table and on the obstacle, on patches and without; the largest too, whose bounds would else end inside it."""
    half, obstacle = domain.half_size[2], domain.obstacles[0]
    for supports in (False, True):
        physics = BatchedPhysics(domain, 3, "cpu", physics_for("swift", supports=supports, resizes=True))
        physics.varied.resize(EVERYONE, EDGES)
        state = physics.qpos.clone()
        for surface, x, y in ((0.0, 0.45, 0.25), (obstacle.centre[2] + obstacle.half_size[2], *obstacle.centre[:2])):
            state[:, 9:] = torch.tensor([x, y, 0.0, 1.0, 0.0, 0.0, 0.0])
            state[:, 11] = surface + half * SCALES + 0.001
            physics.place(EVERYONE, state)
            for _ in range(10):
                physics.advance()
            assert (physics.qpos[:, 11] - surface).numpy() == pytest.approx((half * SCALES).numpy(), abs=1e-3)
    inertia = physics.varied.inertia[:, physics.varied.object_body]
    assert (inertia / inertia[1]).numpy() == pytest.approx((SCALES**2)[:, None].expand(3, 3).numpy(), rel=1e-5)
    assert (
        physics.varied.mass[:, physics.varied.object_body] == physics.varied.mass[0, physics.varied.object_body]
    ).all()


@pytest.mark.parametrize("domain", [BUMP, WALL], ids=lambda d: d.name)
def test_tasks_of_all_kinds_keep_surface_and_gap_whatever_the_size(domain):
    kinds, count = find_task(domain.name).kinds, 3000
    shares = (1 / len(kinds),) * len(kinds)
    plain, sized = (
        draw_tasks(domain, shares, count, torch.Generator().manual_seed(4), size) for size in ((1.0, 1.0), (0.8, 1.2))
    )
    box = domain.obstacles[0]
    assert sized.starts.scale.min() < 0.81 and sized.starts.scale.max() > 1.19
    for own, other in ((plain.starts, sized.starts), (plain.goals, sized.goals)):
        assert own.scale is None and (other.scale == sized.starts.scale).all()
        for axis in range(3):
            reach = [
                (matrix_from_quaternion(p.quaternion)[:, axis].abs() * p.half_size(domain)).sum(-1)
                for p in (own, other)
            ]
            if axis == 2:
                gaps = [p.position[:, 2] - r for p, r in zip((own, other), reach)]
                assert torch.allclose(*gaps, atol=1e-6)
                continue
            away = own.position[:, axis] - box.centre[axis]
            beside = away.abs() > box.half_size[axis]
            gaps = [(p.position[:, axis] - box.centre[axis]) * away.sign() - r for p, r in zip((own, other), reach)]
            assert torch.allclose(gaps[0][beside], gaps[1][beside], atol=1e-6)
            assert torch.equal(own.position[~beside, axis], other.position[~beside, axis])


def test_a_contact_is_chosen_on_the_surface_that_is_there():
    """Fingers stand as far before a large cube as before a small one, and what is reckoned inside of one is free of the other."""
    one = torch.ones(3)
    action = torch.zeros(3, contact.SIZE)
    action[:, 3], action[:, 6:] = -1.0, torch.tensor([0.0, 0.0, 1.0])
    position = torch.stack([0.5 * one, -0.2 * one, BUMP.half_size[2] * SCALES], -1)
    objects = Poses(position, torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(3, 1), EDGES)
    contacts = contact.resolve(BUMP, action, objects)
    apart = contact.gripper_clearance(BUMP, contacts.q, contacts.width, objects)
    assert contacts.feasible.all() and apart.numpy() == pytest.approx(float(apart[1]), abs=5e-4)
    assert (contacts.position[:, 2] - 2 * position[:, 2]).std() < 1e-5
    larger = replace(objects, scale=1.25 * EDGES)
    assert (contact.gripper_clearance(BUMP, contacts.q, contacts.width, larger) < 0).all()


def test_what_is_seen_measured_and_placed_has_the_size_of_the_task():
    conditions = replace(NOMINAL_CONDITIONS, size=(0.8, 1.2))
    env = Environment(BUMP, "cpu", EnvironmentConfig(worlds=6, physics=physics_for("swift", resizes=True)))
    env.config = replace(env.config, conditions=conditions)
    networks = ActorCritic()
    env.starts = env.draw_starts(networks.pre, 40)
    env.reset(torch.arange(6))
    scale = env.physics.varied.scale
    assert len(scale.unique()) == 18
    sides = corners(BUMP, env.objects)
    width = (sides[:, :, None] - sides[:, None]).norm(dim=-1).amax((1, 2))
    assert width.numpy() == pytest.approx((2 * BUMP.half_size[0] * scale.norm(dim=-1)).numpy(), rel=1e-4)
    bare = replace(env.goals, scale=None)
    assert not torch.allclose(corners(BUMP, env.goals), corners(BUMP, bare), atol=1e-3)
    assert torch.allclose(corners(BUMP, env.goals), env.goal_corners)
    seen = env.observe()[0]
    env.physics.varied.scale.fill_(1.0)
    assert not torch.allclose(seen, env.observe()[0], atol=1e-3)
    assert pre_contact_state(env.objects, env.goals).shape == (6, 18)
    env.config = replace(env.config, conditions=NOMINAL_CONDITIONS)
    env.starts = env.draw_starts(networks.pre, 40)
    env.reset(torch.arange(6))
    assert (env.physics.varied.scale == 1.0).all(), "nothing is left of a stage with sizes"


def test_episodes_are_judged_at_one_size_and_leave_none_behind():
    env = Environment(WALL, "cpu", EnvironmentConfig(worlds=3, limit=1, physics=physics_for("swift", resizes=True)))
    networks = ActorCritic()
    large = run_episodes(env, networks, networks.pre, conditions=replace(ROBUST, size=(1.2, 1.2)), seed=3, record=True)
    assert (env.physics.varied.scale == 1.2).all()
    own = run_episodes(env, networks, networks.pre, conditions=replace(ROBUST, size=(1.0, 1.0)), seed=3, record=True)
    assert (env.physics.varied.scale == 1.0).all()
    higher = large.goals[:, 2] - own.goals[:, 2]
    assert higher == pytest.approx(0.2 * WALL.half_size[0], abs=1e-5), "goals lie, thicker, on the wall"


@pytest.mark.parametrize("domain", ["bump", "wall"])
def test_training_with_sizes_runs(domain, tmp_path, monkeypatch):
    options = "--conditions robust --set rollout=2 --worlds 4 --device cpu --iterations 1".split()
    monkeypatch.setattr(sys, "argv", ["train", "--domain", domain, "--out", str(tmp_path), *options])
    trainer = make_trainer(train.parse(), "cpu", 0, None)
    trainer.environment.config = replace(trainer.environment.config, conditions=ROBUST)
    assert trainer.iterate()["steps"] > 0
    assert trainer.environment.physics.take_overflowed() == 0


@pytest.mark.slow
def test_a_student_of_sizes_is_taught_what_the_teacher_does_with_each_and_says_which_it_knows(
    tmp_path, monkeypatch, capsys
):
    """A teacher whose hand stands on the object's top: how high that is the student can only have seen."""
    torch.manual_seed(5)
    networks = ActorCritic()
    with torch.no_grad():
        networks.pre.net[-1].weight.zero_()
        networks.pre.net[-1].bias.copy_(torch.tensor([0.0, 0, 0, -9, 0, 0, 0, 0, 9]))
    state = {"networks": networks.state_dict(), "setting": {"domain": "wall", "contact": "hard"}, "steps": 0}
    torch.save(state, tmp_path / "checkpoint.pt")
    options = [
        "--checkpoint",
        tmp_path / "checkpoint.pt",
        "--out",
        tmp_path,
        "--batch",
        256,
        "--device",
        "cpu",
        "--steps",
        600,
    ]
    monkeypatch.setattr("sys.argv", ["distill", *map(str, options), "--sizes", "0.8", "1.2"])
    distill.main()
    file = json.loads(capsys.readouterr().out.splitlines()[-1])["file"]
    assert read_size_range(read_metadata(file)) == (0.8, 1.2)
    student = Student(load(PreContactNetwork(), file, PolicyContract.of(PRE_CONTACT, WALL)), "default", (0.8, 1.2))
    tasks = draw_tasks(WALL, (1.0,), 400, torch.Generator().manual_seed(9), (0.8, 1.2))
    with torch.no_grad():
        height = student.hand_poses(WALL, tasks.starts, tasks.goals)[0][:, 2]
    edge = tasks.starts.scale[:, 2]
    large, small = edge > 1.15, edge < 0.85
    assert height[large].mean() - height[small].mean() > 0.5 * 0.35 * 2 * WALL.half_size[2]
