"""The student: what it is shown, how long and from where it is taught, and what its files hold."""

import argparse
import io
import json
import sys
from types import SimpleNamespace

import pytest
import torch
from safetensors.torch import load_file
from sim2real.effects.patch import Patch, PatchEffect

from np_control.kinematics import forward_kinematics
from np_description.domains import CARD, WALL
from np_description.objects.choice import domain_with
from np_description.panda import NOMINAL
from np_description.weights.header import read_metadata
from np_policy import hand_pose
from np_policy.contract import PRE_CONTACT
from np_policy.networks import PreContactNetwork
from np_policy.observation import normalise_keypoints, student_observation
from np_policy.weights import save
from np_training.contracts import make_trained_contract
from np_training.environment.object_poses import canonical_poses, corners
from np_training.environment.view import BatchedView
from np_training.ppo import distillation
from np_training.ppo.distillation import Student
from np_training.ppo.networks import ActorCritic, PreContactActor
from np_training.ppo.whitening import Whitening
from np_training.tasks import kinds
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
def watched(monkeypatch):
    """What a teaching draws, shares of the kinds and sizes of every batch; the noise of every step; the floor of the whitening."""
    drawn, shown, floors = [], [], []
    draw, observed, whitening = distillation.draw_tasks, distillation.noisy_observation, Whitening.of
    monkeypatch.setattr(distillation, "draw_tasks", lambda *a: drawn.append((a[1], a[4])) or draw(*a))
    monkeypatch.setattr(distillation, "noisy_observation", lambda *a: shown.append(a[2]) or observed(*a))
    monkeypatch.setattr(Whitening, "of", lambda *a: floors.append(a[1]) or whitening(*a))
    return drawn, shown, floors


def test_noise_is_up_to_a_hundredth_of_an_image_and_differences_below_its_root_mean_square_count_less(watched):
    _, shown, floors = watched
    distillation.distil(CARD, PreContactActor(), "cpu", minutes=0, batch=2000, steps=3)
    assert [level.shape for level in shown] == [(2000, 1, 1)] * 3, "one level for all corners of an image"
    levels = torch.cat(shown)
    assert 0 <= levels.min() < 0.001 and 0.0199 < levels.max() <= 0.02  # 1.0 is half an image
    assert floors == [pytest.approx(levels.square().mean().sqrt().item(), rel=0.02)]


@pytest.mark.parametrize("practice", [None, 0.4])
def test_a_student_is_taught_and_judged_by_the_domains_own_tasks_where_no_practice_is_given(practice, watched):
    own, whole = ((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.6, 0.4, 0.0, 0.0, 0.0, 0.0))
    given = {} if practice is None else {"practice": practice}
    distillation.distil(WALL, PreContactActor(), "cpu", minutes=0, batch=8, steps=9, **given)
    drawn = watched[0]
    # 32 batches at first, a new one for every eighth step, and those it is judged by.
    assert drawn == [(whole if practice else own, (1.0, 1.0))] * (32 + 2) + [(own, (1.0, 1.0))]


def test_a_domain_whose_practice_sinks_every_obstacle_has_its_own_tasks_alone(monkeypatch):
    low = kinds.lower("low", sample_tasks)
    monkeypatch.setattr(distillation, "find_task", lambda name: SimpleNamespace(kinds=(kinds.OWN, *low)))
    assert distillation.shares_with(WALL, 0.4) == (1.0, 0.0, 0.0, 0.0, 0.0)


def taught(**options):
    """Weights and errors of a student after three steps."""
    torch.manual_seed(1)
    teacher = PreContactActor()
    student, errors = distillation.distil(CARD, teacher, "cpu", minutes=0, batch=16, steps=3, **options)
    return [*student.state_dict().values()], errors


def test_a_student_is_taught_the_same_twice_and_otherwise_with_another_seed():
    (first, errors), (second, same), (other, _) = taught(), taught(seed=0), taught(seed=1)
    assert errors == same and all(map(torch.equal, first, second)) and not any(map(torch.equal, first, other))


def test_a_student_that_is_taught_on_begins_as_it_was(tmp_path):
    torch.manual_seed(7)
    before, file = PreContactNetwork(), tmp_path / "student.safetensors"
    save(before, file, make_trained_contract(PRE_CONTACT, CARD))
    after, _ = distillation.distil(CARD, PreContactActor(), "cpu", minutes=0, batch=256, steps=1, begin_with=file)
    seen = distillation.student_input(CARD, *sample_tasks(CARD, 200, torch.Generator().manual_seed(0)))
    with torch.no_grad():
        assert (after(seen) - before(seen)).abs().max() < 0.01  # one step, at a thousandth of the rate


def test_what_a_step_leaves_of_its_gradient_does_not_reach_the_next(monkeypatch):
    step = torch.optim.Adam.step

    def spoil(self):
        step(self)
        for parameter in self.param_groups[0]["params"]:
            parameter.grad.fill_(1e6)

    plain = taught()[0]
    monkeypatch.setattr(torch.optim.Adam, "step", spoil)
    assert all(map(torch.equal, taught()[0], plain))


def test_a_teaching_shows_every_500_steps_at_once_where_it_is(monkeypatch):
    class Pipe(io.StringIO):
        shown = ""

        def flush(self):
            self.shown = self.getvalue()

    monkeypatch.setattr(sys, "stdout", Pipe())
    distillation.distil(CARD, PreContactActor(), "cpu", minutes=4.0, batch=2, steps=1000)
    lines = sys.stdout.shown.splitlines()
    assert [line.split("  ")[::2] for line in lines] == [["step 500", "left 2.0 min"], ["step 1000", "left 0.0 min"]]


def test_images_of_different_tasks_share_no_noise():
    """Noise with a memory goes on from image to image of an episode; these are of as many episodes."""
    view = BatchedView(Patch((PatchEffect("keypoint_noise", "keypoints", {"spread": 3.0, "memory": 0.99}),)))
    objects, goals = sample_tasks(CARD, 2000, torch.Generator().manual_seed(0))
    exact = distillation.student_input(CARD, objects, goals)[:, :16]
    torch.manual_seed(1)
    first, second = (distillation.student_input(CARD, objects, goals, view=view)[:, :16] - exact for _ in range(2))
    assert first.std() > 0 and (first * second).mean().abs() < 0.05 * first.var()


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_student_of_one_size_is_shown_that_size_and_one_of_several_the_object(factor):
    size = [2 * factor * half for half in WALL.half_size]
    text = json.dumps({"name": "other", "domain": "wall", "size": size, "mass": WALL.mass, "surface": "paper"})
    other, network = domain_with("wall", text), PreContactNetwork()
    for domain, trained, alone in ((WALL, {}, True), (other, {}, False), (other, {"sizes": (0.8, 1.2)}, True)):
        objects, goals = sample_tasks(domain, 10, torch.Generator().manual_seed(0))
        with torch.no_grad():
            position = Student(network, **trained).hand_poses(domain, objects, goals)[0]
            itself = hand_pose.decode(network(distillation.student_input(domain, objects, goals)))[0]
        assert torch.equal(position, itself) == alone


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
        effects=Patch(), begin=None, sizes=sizes, out=tmp_path / "deep/out", weights=tmp_path / "elsewhere/weights",
    )  # fmt: skip
    for _ in range(2):  # the second time the folders are there
        line = distillation.distil_checkpoint(arguments, pytest.fail)
    domain, teacher, *rest = taught[0]
    assert domain.name == "wall" and (rest[1:5], rest[6], rest[9]) == ([3.0, 16, 4, 5], 0.2, sizes)
    assert all(torch.equal(mine, networks.pre.state_dict()[name]) for name, mine in teacher.state_dict().items())
    file = tmp_path / "deep/out/pre_contact_student_wall.safetensors"
    played = {"domain": "wall", "object": "default"} | ({"sizes": "0.8 1.2"} if sizes != (1.0, 1.0) else {})
    assert line == {"file": str(file), **played, "practice": 0.2, "steps": 5}
    folder = tmp_path / "elsewhere/weights"
    written = {file: student, folder / "pre_contact_wall.safetensors": student}
    for path, network in (written | {folder / "post_contact_wall.safetensors": networks.post}).items():
        tensors = load_file(path)
        assert all(torch.equal(mine, tensors[name]) for name, mine in network.state_dict().items())
        assert played.items() <= read_metadata(path).items()


def test_an_object_that_the_domain_has_not_is_refused(checkpoint):
    class Refused(Exception):
        pass

    def refuse(line):
        raise Refused(line)

    arguments = argparse.Namespace(checkpoint=checkpoint[0], device="cpu", domain=None, object="sofa")
    with pytest.raises(Refused, match="sofa"):
        distillation.distil_checkpoint(arguments, refuse)


def test_student_output_and_pose_are_inverse():
    q = torch.tensor(NOMINAL.ready) + 0.2 * torch.randn(20, 7, dtype=torch.float64)
    position, rotation = forward_kinematics(q)
    width = torch.linspace(0, 0.04, 20, dtype=torch.float64)
    p, r, w = hand_pose.decode(hand_pose.encode(position, rotation, width))
    assert (p - position).abs().max() < 1e-6 and (r - rotation).abs().max() < 1e-6 and (w - width).abs().max() < 1e-6
