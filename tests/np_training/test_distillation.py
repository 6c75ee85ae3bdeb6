"""The student: what it is shown, how long and from where it is taught, and what its files hold."""

import argparse
from types import SimpleNamespace

import pytest
import torch
from safetensors.torch import load_file
from sim2real.effects.patch import Patch

from np_control.kinematics import forward_kinematics
from np_description.domains import CARD
from np_description.panda import NOMINAL
from np_description.weights.header import read_metadata
from np_policy import hand_pose
from np_policy.networks import PreContactNetwork
from np_policy.observation import normalise_keypoints, student_observation
from np_training.environment.object_poses import canonical_poses, corners
from np_training.ppo import distillation
from np_training.ppo.networks import ActorCritic, PreContactActor
from np_training.tasks.poses import sample_tasks


def test_a_student_is_shown_keypoints_with_noise_and_goals_without():
    objects, goals = sample_tasks(CARD, 4000, torch.Generator().manual_seed(0))
    shown = [normalise_keypoints(corners(CARD, poses)) for poses in canonical_poses(CARD, objects, goals)]
    exact = student_observation(*shown)
    torch.testing.assert_close(distillation.student_input(CARD, objects, goals), exact)
    torch.manual_seed(1)
    levels = torch.tensor([0.0, 0.01]).repeat(2000)[:, None, None]
    noise = distillation.student_input(CARD, objects, goals, levels) - exact
    assert (noise[0::2] == 0).all()
    assert noise[1::2, :16].std(0).tolist() == pytest.approx([0.01] * 16, rel=0.1)
    wanted = shown[1].flatten(1)  # keypoint and difference to the goal share the noise: the goal itself has none
    gain = (exact[:, 16:] / (wanted - exact[:, :16])).median()
    torch.testing.assert_close(noise[:, 16:], -gain * noise[:, :16], atol=1e-4, rtol=1e-3)


def recorded(monkeypatch):
    """Learning rates of the steps that an optimiser makes from now on."""
    rates, step = [], torch.optim.Adam.step

    def noted(self, *arguments):
        rates.append(self.param_groups[0]["lr"])
        return step(self, *arguments)

    monkeypatch.setattr(torch.optim.Adam, "step", noted)
    return rates


def test_the_rate_falls_in_a_line_to_a_thousandth_over_the_steps(monkeypatch):
    rates = recorded(monkeypatch)
    assert distillation.distil(CARD, PreContactActor(), "cpu", minutes=0, batch=8, steps=4)[1]["steps"] == 4
    assert rates == pytest.approx([0.75e-3, 0.5e-3, 0.25e-3, 1e-6])


def test_of_the_tasks_that_are_kept_the_oldest_give_way_to_new_ones(monkeypatch):
    monkeypatch.setattr(distillation, "POOL", 4)
    monkeypatch.setattr(distillation, "REUSE", 2)
    drawn, shown = [], []
    keypoints, observed = distillation._keypoints, distillation.noisy_observation
    monkeypatch.setattr(distillation, "_keypoints", lambda *a: drawn.append(keypoints(*a)) or drawn[-1])
    monkeypatch.setattr(distillation, "noisy_observation", lambda *a: shown.append(a[1]) or observed(*a))
    distillation.distil(CARD, PreContactActor(), "cpu", minutes=0, batch=64, steps=8)
    whose = {tuple(goal): number for number, (_, goals) in enumerate(drawn) for goal in goals.flatten(1).tolist()}
    batches = [{whose[tuple(goal)] for goal in goals.flatten(1).tolist()} for goals in shown]
    assert batches == [kept for kept in ({1, 2, 3, 4}, {2, 3, 4, 5}, {3, 4, 5, 6}, {4, 5, 6, 7}) for _ in range(2)]


def test_minutes_end_the_teaching_where_no_steps_are_given(monkeypatch):
    rates, now = recorded(monkeypatch), iter((0.0, 30.0, 60.0, 150.0))
    monkeypatch.setattr(distillation, "time", SimpleNamespace(monotonic=lambda: next(now)))
    assert distillation.distil(CARD, PreContactActor(), "cpu", minutes=2.0, batch=8)[1]["steps"] == 3
    assert rates == pytest.approx([0.75e-3, 0.5e-3, 1e-6])


@pytest.fixture
def checkpoint(tmp_path):
    """One of a training of the wall, with its networks."""
    networks = ActorCritic()
    setting = {"domain": "wall", "contact": "hard", "damping_floor": 0.7}
    torch.save({"networks": networks.state_dict(), "setting": setting, "steps": 0}, tmp_path / "checkpoint.pt")
    return tmp_path / "checkpoint.pt", networks


@pytest.mark.parametrize("sizes", [(1.0, 1.0), (0.8, 1.2)])
def test_of_a_checkpoint_the_contact_policy_is_taught_and_both_policies_are_written(
    checkpoint, sizes, tmp_path, monkeypatch
):
    path, networks = checkpoint
    student, taught = PreContactNetwork(), []
    monkeypatch.setattr(distillation, "distil", lambda *arguments: taught.append(arguments) or (student, {"steps": 5}))
    arguments = argparse.Namespace(
        checkpoint=path, device="cpu", domain=None, object=None, minutes=3.0, batch=16, seed=4, steps=5, practice=0.2,
        effects=Patch(), begin=None, sizes=sizes, out=tmp_path / "deep/out", weights=tmp_path / "deep/weights",
    )  # fmt: skip
    for _ in range(2):  # the second time the folders are there
        line = distillation.distil_checkpoint(arguments, pytest.fail)
    domain, teacher, *rest = taught[0]
    assert domain.name == "wall" and (rest[1:5], rest[6], rest[9]) == ([3.0, 16, 4, 5], 0.2, sizes)
    assert all(torch.equal(mine, networks.pre.state_dict()[name]) for name, mine in teacher.state_dict().items())
    file = tmp_path / "deep/out/pre_contact_student_wall.safetensors"
    played = {"domain": "wall", "object": "default"} | ({"sizes": "0.8 1.2"} if sizes != (1.0, 1.0) else {})
    assert line == {"file": str(file), **played, "practice": 0.2, "steps": 5}
    folder = tmp_path / "deep/weights"
    written = {file: student, folder / "pre_contact_wall.safetensors": student}
    for path, network in (written | {folder / "post_contact_wall.safetensors": networks.post}).items():
        tensors = load_file(path)
        assert all(torch.equal(mine, tensors[name]) for name, mine in network.state_dict().items())
        assert played.items() <= read_metadata(path).items()


def test_student_output_and_pose_are_inverse():
    q = torch.tensor(NOMINAL.ready) + 0.2 * torch.randn(20, 7, dtype=torch.float64)
    position, rotation = forward_kinematics(q)
    width = torch.linspace(0, 0.04, 20, dtype=torch.float64)
    p, r, w = hand_pose.decode(hand_pose.encode(position, rotation, width))
    assert (p - position).abs().max() < 1e-6 and (r - rotation).abs().max() < 1e-6 and (w - width).abs().max() < 1e-6
