"""What departs from the paper and can be switched off: every switch takes effect (docs/reference/paper.md)."""

import sys

import pytest
import torch

from np_description.domains import BUMP, CARD
from np_description.panda import FINGER_MAX
from np_training import train
from np_training.detector.augment import Augmentation, replace_background
from np_training.detector.training import augmentation_for
from np_training.environment import contact
from np_training.ppo.training import make_trainer
from np_training.setting import domain_of
from np_training.tasks.poses import sample_tasks

TINY = ["--worlds", "8", "--set", "rollout=2", "limit=3", "--device", "cpu"]


def trainer(monkeypatch, tmp_path, *options: str):
    """The trainer that the command line makes, untrained."""
    monkeypatch.setattr(sys, "argv", ["train", "--domain", "bump", "--out", str(tmp_path), *TINY, *options])
    return make_trainer(train.parse(), "cpu", 0, None)


@pytest.mark.slow
def test_without_practice_and_random_contacts_every_episode_is_the_domains_own(tmp_path, monkeypatch):
    usual = trainer(monkeypatch, tmp_path)
    assert usual.curriculum.shares[0] == pytest.approx(0.25) and usual.curriculum.explore == pytest.approx(0.3)
    bare = trainer(monkeypatch, tmp_path, "--set", "practice=0", "explore=0")
    bare.iterate()
    environment = bare.environment
    assert environment.config.shares[0] == 1 and sum(environment.config.shares) == 1 and environment.config.explore == 0
    assert (environment.starts.tasks.kind == 0).all() and (environment.starts.tasks.sunk == 0).all()
    usual.iterate()
    assert (usual.environment.starts.tasks.kind > 0).any() and (usual.environment.starts.tasks.sunk > 0).any()


@pytest.mark.parametrize("opening", [0.0, BUMP.max_opening, FINGER_MAX])
def test_fingers_open_as_far_as_the_training_lets_them(opening, tmp_path, monkeypatch):
    chosen = trainer(monkeypatch, tmp_path, "--set", f"max_opening={opening}")
    assert chosen.setting["max_opening"] == opening
    domain = domain_of(chosen.setting)  # as distillation and evaluation make it
    objects, _ = sample_tasks(domain, 500, torch.Generator().manual_seed(0))
    action = 2 * torch.rand(500, contact.SIZE, generator=torch.Generator().manual_seed(1)) - 1
    action[0, 3] = 1.0
    _, _, width = contact.contact_pose(domain, action, objects)
    assert width.max() == pytest.approx(opening) and (width >= 0).all()
    assert (chosen.environment.starts.contacts.width <= opening + 1e-6).all()


@pytest.mark.parametrize("opening", [-0.001, FINGER_MAX + 0.001])
def test_an_opening_that_no_finger_has_is_refused(opening, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["train", "--set", f"max_opening={opening}"])
    with pytest.raises(SystemExit):
        train.parse()
    assert f"max_opening: expected 0 to {FINGER_MAX} m, got {opening:g}" in capsys.readouterr().err


def test_the_critic_sees_more_than_the_policy(tmp_path, monkeypatch):
    chosen = trainer(monkeypatch, tmp_path)
    seen = []
    chosen.networks.post_value.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0].detach().clone()))
    chosen.iterate()
    size = chosen.networks.post.net[0].in_features
    assert seen and all((part[..., :size] != 0).any() for part in seen)
    assert all((part[..., size:] != 0).any() for part in seen)


def test_a_time_limit_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["train", "--domain", "card"])
    assert train.parse().stages[0].limit == 200
    chosen = trainer(monkeypatch, tmp_path, "--domain", "card", "--set", "limit=1")
    out = chosen.environment.step(torch.zeros(8, 20))
    assert chosen.environment.domain == CARD and out["done"].all()


def test_backgrounds_are_replaced_as_often_as_asked():
    images = torch.full((2000, 3, 4, 4), 0.5)

    def replaced(**flags: bool) -> float:
        augmentation = augmentation_for(**flags)
        new = replace_background(images, torch.ones(2000, 1, 4, 4), torch.Generator().manual_seed(0), augmentation)
        return (new != images).flatten(1).any(1).float().mean().item()

    assert replaced(keep=True, always=False) == 0
    assert replaced(keep=False, always=False) == pytest.approx(0.6, abs=0.04)
    assert replaced(keep=False, always=True) == 1
    assert augmentation_for(False, False) == Augmentation()
