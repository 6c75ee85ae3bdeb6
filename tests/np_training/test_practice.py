"""Drawn tasks and kinds of practice: where objects lie, how far they turn, and how the curriculum shares them out."""

import numpy as np
import pytest
import torch

from np_common.rotations import matrix_from_quaternion, rotation_angle
from np_description.domains import BUMP, DOMAINS, WALL
from np_training.ppo import curriculum
from np_training.tasks import kinds, practice
from np_training.tasks.bump import YAWS
from np_training.tasks.poses import quarter_tips, sample_tasks
from np_training.tasks.registry import find_task


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=lambda d: d.name)
def test_batched_tasks_keep_to_the_domain(domain):
    starts, goals = sample_tasks(domain, 2000, torch.Generator().manual_seed(2))
    assert ((starts.position - goals.position).norm(dim=-1) >= domain.min_distance).all()
    for axis, bounds in enumerate((domain.start.x, domain.start.y)):
        assert (starts.position[:, axis] >= bounds[0] - 1e-6).all() and (
            starts.position[:, axis] <= bounds[1] + 1e-6
        ).all()
    lowest = min(domain.half_size) + domain.start.surface
    assert (starts.position[:, 2] >= lowest - 1e-6).all()
    assert torch.allclose(goals.quaternion.norm(dim=-1), torch.ones(2000), atol=1e-5)


def top_of(domain):
    return max(box.centre[2] + box.half_size[2] for box in domain.obstacles)


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=lambda d: d.name)
def test_tasks_of_every_kind_rest_beside_or_on_obstacles_and_come_in_their_shares(domain):
    names = find_task(domain.name).kinds
    shares = tuple(torch.softmax(torch.arange(float(len(names))), 0).tolist())
    tasks = practice.draw_tasks(domain, shares, 4000, torch.Generator().manual_seed(7))
    counts = torch.bincount(tasks.kind, minlength=len(names)) / 4000
    assert torch.allclose(counts, torch.tensor(shares), atol=1e-3)
    half_size = torch.tensor(domain.half_size)
    for poses in (tasks.starts, tasks.goals):
        turned = matrix_from_quaternion(poses.quaternion).abs() @ half_size  # half the box around the object
        bottom = poses.position[:, 2] - turned[:, 2]
        for box in domain.obstacles:
            apart = (
                (poses.position - torch.tensor(box.centre))[:, :2].abs()
                - torch.tensor(box.half_size)[:2]
                - turned[:, :2]
            )
            surface = torch.where((apart > -1e-6).any(-1), 0.0, top_of(domain) - tasks.sunk)
            assert torch.allclose(bottom, surface, atol=1e-6)
        if not domain.obstacles:
            assert torch.allclose(bottom, torch.zeros(()), atol=1e-6)


def test_a_kind_says_how_far_obstacles_are_lowered():
    for domain in (BUMP, WALL):
        names = find_task(domain.name).kinds
        tasks = practice.draw_tasks(domain, (1 / len(names),) * len(names), 3000, torch.Generator().manual_seed(8))
        for number, kind in enumerate(names):
            share = tasks.sunk[tasks.kind == number] / top_of(domain)
            assert (share >= kind.lowered[0] - 1e-6).all() and (share <= kind.lowered[1] + 1e-6).all()
    assert [kind.lowered for kind in names if kind.name.startswith("low")] == [
        (0.75, 1),
        (0.5, 0.75),
        (0.25, 0.5),
        (0, 0.25),
    ]


def test_practice_on_the_bump_turns_little_and_its_own_tasks_turn_much():
    generator = torch.Generator().manual_seed(7)
    for number, kind in enumerate(find_task("bump").kinds):
        shares = tuple(float(k == number) for k in range(len(find_task("bump").kinds)))
        tasks = practice.draw_tasks(BUMP, shares, 3000, generator)
        tips = torch.bincount(quarter_tips(tasks.starts, tasks.goals), minlength=3) / 3000
        if kind.name in ("own", "again"):
            assert tips.min() > 0.1
        elif kind.name.startswith("turn"):
            assert tips[2] == 0 and 0.4 < tips[1] < 0.5  # axes 1 and 2 of 3, two of three turns
        else:
            assert tips[int(kind.name.startswith("roll"))] == 1


def test_what_is_to_be_corrected_lies_beside_its_goal_turned_about_the_vertical():
    starts, goals = kinds.corrects(BUMP, 2000, torch.Generator().manual_seed(7))
    angle = rotation_angle(starts.quaternion, goals.quaternion)
    assert kinds.LEFT - 1e-3 < angle.min() and angle.max() > 0.95 * torch.pi
    away = (starts.position - goals.position).abs()
    assert (away[:, :2] <= kinds.NEAR + 1e-6).all() and torch.allclose(away[:, 2], torch.zeros(()), atol=1e-6)
    assert (away.norm(dim=-1) < BUMP.min_distance).float().mean() > 0.3  # some where they have to be, but for the turn


def test_practice_is_kept_where_one_says_so():
    configs = (curriculum.CurriculumConfig(practice=0.75, kept=share) for share in (0.4, 0.0))
    kept, gone = (curriculum.Curriculum(10, config, practices=2) for config in configs)
    for one in (kept, gone):
        assert 1 - one.shares[0] == pytest.approx(0.75)
        one.advance(1.0, 100)
    assert 1 - kept.shares[0] == pytest.approx(0.4) and 1 - gone.shares[0] == pytest.approx(0.0)


@pytest.mark.parametrize("name", ["slide", "cross"])
def test_the_grades_of_practice_turn_the_cube_further_and_further(name):
    for grade, yaw in enumerate(YAWS, 1):
        shares = tuple(float(kind.name == f"{name}{grade}") for kind in find_task("bump").kinds)
        tasks = practice.draw_tasks(BUMP, shares, 1000, torch.Generator().manual_seed(9))
        angle = rotation_angle(tasks.starts.quaternion, tasks.goals.quaternion)
        assert 0.9 * yaw < angle.max() <= yaw + 1e-3


def test_a_cube_rolls_the_way_it_moves(monkeypatch):
    monkeypatch.setattr(kinds, "SQUARE", 0.0)
    starts, goals = kinds.rolls(BUMP, 500, torch.Generator().manual_seed(8), yaw=0.0)
    towards = (goals.position - starts.position)[:, 1].sign()
    top = matrix_from_quaternion(starts.quaternion)[:, 2]  # the upward direction, in the object's frame
    now = (matrix_from_quaternion(goals.quaternion) @ top[..., None])[..., 0]
    assert torch.allclose(now, torch.stack([0 * towards, towards, 0 * towards], -1), atol=1e-5)


def test_practice_is_drawn_where_success_varies_and_ends_with_success():
    own = curriculum.Curriculum(100, curriculum.CurriculumConfig(practice=0.75, explore=0.3), practices=3)
    assert own.shares == pytest.approx((0.25, 0.25, 0.25, 0.25)) and own.explore == 0.3
    for _ in range(30):
        for number, success in enumerate((0.0, 0.5, 1.0)):
            own.practise(number, success, 50)
    assert sum(own.shares) == pytest.approx(1) and own.shares[0] == pytest.approx(0.25)
    assert own.shares[2] > 5 * own.shares[1] and own.shares[1] == pytest.approx(own.shares[3], rel=0.01)
    own.advance(0.3, 1000)
    assert own.shares[0] == pytest.approx(1 - 0.75 / 2) and own.explore == pytest.approx(0.15)
    own.advance(0.7, 1000)
    assert own.shares == (1, 0, 0, 0) and own.explore == 0


def test_a_stage_begun_anew_is_won_anew():
    own = curriculum.Curriculum(100, curriculum.CurriculumConfig(practice=0.75), practices=2)
    own.stage, own.success, own.episodes, own.practised = own.last, 0.99, 5000, [1.0, 0.9]
    own.go_back(curriculum.STAGES)
    assert own.randomisation == 0 and own.shares[0] == pytest.approx(0.25) and own.practised == [0.5, 0.5]
    assert not own.advance(0.5, 60) and own.success == 0.5, "the first episodes count alone"
    assert own.advance(1.0, 1000) and own.randomisation > 0
    for stage in (-1, curriculum.STAGES + 1):
        with pytest.raises(ValueError, match=f"stage: expected 0 to {curriculum.STAGES}, got {stage}"):
            own.go_back(stage)


def test_curriculum_is_geometric_from_loose_to_tight():
    limits = [curriculum.stage_limits(stage) for stage in range(curriculum.STAGES + 2)]
    ratios = [b.position / a.position for a, b in zip(limits[:-2], limits[1:-1])]
    assert np.allclose(ratios, ratios[0]) and limits[-1] == limits[-2]
    assert np.allclose((limits[0].rotation, limits[-1].rotation), (0.1, 0.03))
