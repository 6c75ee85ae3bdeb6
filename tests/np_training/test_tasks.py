"""The tasks that can be trained: one for every domain, found by name."""

import pytest

from np_description.domains import DOMAINS
from np_training import train
from np_training.tasks.registry import TASKS, find_task


def test_every_domain_has_a_task_whose_own_kind_comes_first():
    assert [task.domain for task in TASKS.values()] == list(DOMAINS.values())
    for name, task in TASKS.items():
        assert find_task(name) is task and task.kinds[0].name == "own"
        assert len({kind.name for kind in task.kinds}) == len(task.kinds)
        assert (len(task.kinds) > 1) == (task.practice > 0)  # who practises has something to practise


def test_a_task_that_does_not_exist_names_those_that_do():
    with pytest.raises(ValueError, match="task: expected one of card, bump, wall, got 'cup'"):
        find_task("cup")


@pytest.mark.parametrize("name", TASKS)
def test_the_command_line_has_its_defaults_from_the_task(name, monkeypatch):
    monkeypatch.setattr("sys.argv", ["train", "--domain", name])
    chosen, task = train.parse().stages[0], find_task(name)
    names = ("limit", "practice", "explore")
    assert [getattr(chosen, key) for key in names] == [getattr(task, key) for key in names]
    assert chosen.reward["far"] == task.far
    monkeypatch.setattr("sys.argv", ["train", "--domain", name, "--set", "reward={'far': 7}", "limit=9"])
    chosen = train.parse().stages[0]
    assert (chosen.reward["far"], chosen.limit) == (7, 9)
