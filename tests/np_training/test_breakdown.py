"""Groups of episodes by what their tasks ask for."""

from dataclasses import replace
from math import pi

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from np_common.rotations import matrix_from_vector, quaternion_from_matrix
from np_description.domains import BUMP, CARD, DOMAINS
from np_training.reports.words import task_label
from np_training.tasks.breakdown import goal_region, groups, groups_of_tasks
from np_training.tasks.poses import Poses, quarter_tips, sample_poses, sample_tasks


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=lambda d: d.name)
def test_poses_are_found_in_the_region_they_were_drawn_from(domain):
    generator = torch.Generator().manual_seed(0)
    for number, region in enumerate(domain.goals):
        assert (goal_region(domain, sample_poses(domain, region, 300, generator).position) == number).all()


def test_every_task_of_the_bump_is_in_one_group_of_each_kind():
    masks = groups_of_tasks(BUMP, *sample_tasks(BUMP, 2000, torch.Generator().manual_seed(1)))
    for kind in ("tips", "goal"):
        assert (sum(mask.int() for name, mask in masks.items() if name.startswith(kind)) == 1).all()
    assert all(mask.float().mean() > 0.1 for mask in masks.values())


def test_groups_are_said_in_words():
    masks = [
        *groups_of_tasks(BUMP, *sample_tasks(BUMP, 10, torch.Generator())),
        *groups_of_tasks(CARD, *sample_tasks(CARD, 10, torch.Generator())),
    ]
    words = [task_label(name) for name in masks]
    assert words[:4] == ["0 quarter turns over", "1 quarter turn over", "2 quarter turns over", "goal region 0"]
    assert "turned by up to 45 degrees" in words and task_label("push_far") == "push far"


def test_a_domain_without_a_choice_has_no_groups():
    assert groups(CARD, torch.zeros(5), torch.zeros(5, 3)) == {}


@given(st.integers(0, 3), st.floats(-3.1, 3.1), st.floats(-3.1, 3.1))
def test_tips_are_quarter_turns_about_the_horizontal_whatever_the_yaw(quarters, before, after):
    def turn(*vector):
        return matrix_from_vector(torch.tensor(vector, dtype=torch.float64))

    start = turn(0.0, 0.0, before)
    goal = turn(0.0, 0.0, after) @ turn(quarters * torch.pi / 2, 0.0, 0.0) @ start
    poses = [Poses(torch.zeros(1, 3), quaternion_from_matrix(m)[None]) for m in (start, goal)]
    assert quarter_tips(*poses).item() == min(quarters, 4 - quarters)


def test_every_task_of_a_domain_that_turns_is_in_one_group_of_turns_of_like_size():
    domain = replace(CARD, goal_yaw=(-pi, pi))
    masks = groups_of_tasks(domain, *sample_tasks(domain, 2000, torch.Generator().manual_seed(1)))
    assert list(masks) == ["turn45", "turn90", "turn135", "turn180"]
    assert (sum(mask.int() for mask in masks.values()) == 1).all()
    assert all(0.2 < mask.float().mean() < 0.3 for mask in masks.values())
