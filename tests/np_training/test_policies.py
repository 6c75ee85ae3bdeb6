"""Training of the policies, tiny, on the CPU: the same code as on a GPU."""

import csv
import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from np_common.rotations import quaternion_from_matrix, rotation_angle
from np_control.impedance import torque
from np_description.domains import BUMP, CARD
from np_description.panda import NOMINAL
from np_policy.action import STIFFNESS
from np_policy.networks import PreContactNetwork
from np_training import train
from np_training.environment import contact
from np_training.environment.config import EnvironmentConfig
from np_training.environment.environment import Environment
from np_training.environment.object_poses import PRE_STATE_SIZE, pre_contact_state
from np_training.episodes.evaluation import evaluate
from np_training.physics.batched import BatchedPhysics
from np_training.physics.config import PhysicsConfig
from np_training.ppo import curriculum
from np_training.ppo.config import TrainConfig
from np_training.ppo.distillation import Student, distil, shares_with
from np_training.ppo.networks import ActorCritic, PreContactActor, sample
from np_training.ppo.trainer import Trainer
from np_training.reports.releasing import without_optimisers
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


def test_a_resumed_run_keeps_its_mean_success_and_so_its_practice(environment):
    before = Trainer(environment, TrainConfig(rollout=1))
    before.curriculum.advance(0.5, 3 * before.curriculum.window)
    after = Trainer(environment, TrainConfig(rollout=1))
    after.load_state_dict(before.state_dict())
    after.curriculum.advance(0.0, after.curriculum.window // 4)
    assert after.curriculum.success == pytest.approx(0.375)


def test_both_learners_get_returns_against_their_critics_and_contacts_out_of_reach_count_as_failures(
    environment, monkeypatch
):
    trainer, seen = Trainer(environment, TrainConfig(rollout=3, pre_least=1)), {}
    for name in ("post", "pre"):
        monkeypatch.setattr(
            getattr(trainer, name), "update", lambda samples, name=name: seen.update({name: samples}) or {}
        )
    starts = environment.starts
    trainer.iterate()
    assert environment.starts is not starts, "contacts are drawn anew, by the policy as it is"
    for name, critic in (("post", trainer.networks.post_value), ("pre", trainer.networks.pre_value)):
        with torch.no_grad():
            value = critic(seen[name].critic_state)[:, 0]
        torch.testing.assert_close(seen[name].returns - seen[name].advantage, value, atol=1e-4, rtol=1e-4)
    rejected = environment.starts.rejected()
    assert len(rejected) and (seen["pre"].returns[-len(rejected) :] == 0.02 * -100).all()
    assert torch.equal(seen["pre"].state[-len(rejected) :], environment.starts.state[rejected])


def test_a_run_goes_on_from_a_released_checkpoint_at_its_learning_rate(environment):
    before = Trainer(environment, TrainConfig(rollout=1))
    before.post.rate = 7e-5
    released = without_optimisers(before.state_dict())
    assert set(released["post"]) == {"rate"}
    after = Trainer(environment, TrainConfig(rollout=1))
    after.load_state_dict(released)
    assert after.post.rate == pytest.approx(7e-5)
    theirs = before.networks.state_dict()
    assert all(torch.equal(value, theirs[name]) for name, value in after.networks.state_dict().items())
    after.iterate()


def test_few_episodes_leave_the_contact_policy_as_it_is(environment, monkeypatch):
    def played(least):
        trainer, seen = Trainer(environment, TrainConfig(rollout=2, pre_least=least)), []
        for learner in (trainer.post, trainer.pre):
            monkeypatch.setattr(learner, "update", lambda samples: seen.append(len(samples.state)) or {"kl": 1.0})
        row = trainer.iterate()
        assert ("pre_kl" in row) == ("pre_std" in row) == (len(seen) == 2)
        return seen

    steps, episodes = played(1)
    assert steps == 2 * WORLDS
    assert played(episodes) == [steps, episodes] and played(episodes + 1) == [steps]


def test_sums_of_a_step_leave_practice_out_of_the_domains_own_episodes(environment):
    trainer = Trainer(environment, TrainConfig(rollout=1))
    trainer.kinds = ["own", "roll"]
    trainer.environment = SimpleNamespace(
        domain=CARD, kind=torch.tensor([0, 0, 0, 1, 1]), age=torch.tensor([3, 5, 7, 11, 13]),
        total=torch.tensor([1.0, 2.0, 4.0, 8.0, 16.0]), tips=None, goals=SimpleNamespace(position=None),
    )  # fmt: skip
    masks = {
        "done": "11010", "success": "10010", "broken": "00001", "lost": "01010", "stopped": "01000", "pressed": "11010",
        "timeout": "00110",
    }  # fmt: skip
    out = {name: torch.tensor([c == "1" for c in text]) for name, text in masks.items()}
    finger, bare = torch.tensor([True, False, True, False, False]), torch.tensor([True, True, False, False, False])
    out |= {
        "touch": SimpleNamespace(finger=finger, bare=bare), "distance": torch.arange(5.0), "angle": 2 * torch.arange(5.0),
        "terms": {"gains": torch.ones(5)},
    }  # fmt: skip
    assert {name: float(value) for name, value in trainer._count(out).items()} == {
        "done": 2, "success": 1, "broken": 1, "lost": 1, "stopped": 1, "pressed": 2, "timeout": 0, "touching": 3,
        "bare": 2, "length": 8, "total": 3, "end_distance": 1, "end_angle": 2, "done_roll": 1, "success_roll": 1,
        "reward_gains": 5,
    }  # fmt: skip


def test_an_untrained_policy_commands_the_stiffness_of_the_setting(environment):
    trainer = Trainer(environment, TrainConfig(stiffness=0.5))
    assert trainer.networks.post.net[-1].bias[STIFFNESS].tanh().tolist() == pytest.approx([0.5] * 7)
    assert Trainer(environment).networks.post.net[-1].bias[STIFFNESS].abs().max() == 0


def test_a_row_of_the_log_has_means_over_episodes_steps_and_kinds_of_practice(environment):
    trainer = Trainer(environment, TrainConfig(rollout=5, curriculum=curriculum.CurriculumConfig(practice=0.5)))
    trainer.kinds, trainer.curriculum.practised = ["own", "roll", "turn"], [0.0, 0.0]
    sums = {
        "done": 20.0, "success": 10.0, "lost": 5.0, "stopped": 4.0, "pressed": 3.0, "timeout": 2.0, "length": 60.0,
        "total": 40.0, "end_distance": 0.8, "end_angle": 8.0, "broken": 7.0, "overflowed": 6.0, "pre_feasible": 30.0,
        "drawn": 40.0, "touching": 8.0, "bare": 2.0, "done_roll": 8.0, "success_roll": 6.0, "done_turn": 0.0,
        "success_turn": 0.0, "reward_progress": 160.0,
    }  # fmt: skip
    row = trainer._row(sums)
    expected = {
        "iteration": 1, "steps": 5 * WORLDS, "stage": 0, "randomisation": 0, "episodes": 20, "practice": 0.5,
        "success": 0.5, "success_mean": 0.5, "lost": 0.25, "stopped": 0.2, "pressed": 0.15, "timeout": 0.1, "length": 3,
        "total": 2, "end_distance": 0.04, "end_angle": 0.4, "broken": 7, "overflowed": 6, "pre_feasible": 0.75,
        "touching": 8 / (5 * WORLDS), "bare": 0.25, "success_roll": 0.75, "success_turn": 0,
        "reward_progress": 160 / (5 * WORLDS),
    }  # fmt: skip
    assert row == pytest.approx(expected)
    assert trainer.curriculum.practised == pytest.approx([0.75, 0.0])
    empty = trainer._row(dict.fromkeys(sums, 0.0) | {"drawn": 1.0})
    assert empty["steps"] == 10 * WORLDS and empty["success"] == empty["bare"] == 0 and empty["success_mean"] == 0.5


def test_a_stage_of_a_recipe_is_over_by_its_steps_or_by_a_window_of_success_under_full_randomisation(environment):
    trainer = Trainer(environment, TrainConfig(rollout=1))
    trainer.steps = 100
    trainer.begin_stage(3)
    assert trainer.recipe_stage == 3
    trainer.steps = 149
    assert not trainer.is_over(None, 50) and not trainer.is_over(0.9, 50)
    trainer.steps = 150
    assert trainer.is_over(None, 50)
    own = trainer.curriculum
    for stage, episodes, success, over in (
        (own.last, own.window, 0.9, True),
        (own.last - 1, own.window, 0.9, False),
        (own.last, own.window - 1, 0.9, False),
        (own.last, own.window, 0.89, False),
    ):
        own.stage, own.episodes, own.success = stage, episodes, success
        assert trainer.is_over(0.9, 51) == over and not trainer.is_over(None, 51)
    trainer.begin_stage(4)
    assert own.episodes == 0 and trainer.stage_begun == 150


def test_a_stage_of_the_curriculum_sets_how_strict_episodes_are(environment):
    before = environment.config
    trainer = Trainer(environment, TrainConfig(rollout=1, hold=5, tolerance=0.6))
    for stage, hold, tolerance, reflex in (
        (0, 1, 1.0, False),
        (curriculum.STAGES, 1, 1.0, False),
        (curriculum.STAGES + 5, 3, 0.8, True),
        (curriculum.STAGES + 10, 5, 0.6, True),
    ):
        trainer.curriculum.stage = stage
        trainer._apply_stage()
        config = environment.config
        assert (config.hold, config.reflex) == (hold, reflex) and config.tolerance == pytest.approx(tolerance)
        assert config.strictness == stage / 20 and environment.limits == curriculum.stage_limits(stage)
    environment.config = before


def test_a_checkpoint_brings_back_everything_but_the_episodes_under_way(environment, tmp_path):
    config, before = environment.config, Trainer(environment, TrainConfig(rollout=1))
    before.curriculum.practised = [0.25, 0.75]
    before.curriculum.stage, before.curriculum.success, before.curriculum.episodes = 13, 0.7, 9
    before.iteration, before.steps, before.seconds, before.recipe_stage, before.stage_begun = 5, 80, 2.5, 2, 30
    before.save(tmp_path / "checkpoint.pt")
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.pt"]
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    after = Trainer(environment, TrainConfig(rollout=1))
    after.curriculum.practised = [0.0, 0.0]
    after.load_state_dict(state)
    same = "iteration", "steps", "seconds", "stage", "success", "episodes", "practised", "recipe_stage", "stage_begun"
    assert {name: after.state_dict()[name] for name in same} == {name: state[name] for name in same}
    assert after.environment.limits == curriculum.stage_limits(13) and after.environment.config.strictness == 0.65
    drawn = torch.rand(3)
    after.load_state_dict(state)
    assert torch.equal(torch.rand(3), drawn), "the same in a repeated run"
    after.load_state_dict(state | {"iteration": 6})
    assert not torch.equal(torch.rand(3), drawn), "others when it goes on later"
    # Of a checkpoint without these the randomisation grew at once, in stage 11.
    unknown = "seconds", "growth", "success", "episodes", "practised", "recipe_stage", "stage_begun"
    after.load_state_dict({name: value for name, value in state.items() if name not in unknown} | {"stage": 11})
    assert (after.seconds, after.curriculum.success, after.curriculum.episodes) == (0.0, 0.0, 0)
    assert (after.recipe_stage, after.stage_begun, after.curriculum.stage) == (0, 0, 20)
    environment.config = config


def test_actions_are_drawn_no_wider_than_the_setting_once_randomised(environment):
    wide = Trainer(environment, TrainConfig(rollout=1))
    narrow = Trainer(environment, TrainConfig(rollout=1, deviation=0.1))
    narrow.load_state_dict(wide.state_dict())
    narrow.iterate()
    assert narrow.networks.post.log_std.exp().min() > 0.4
    for stage, most in ((curriculum.STAGES + 5, 0.1**0.5), (narrow.curriculum.last, 0.1)):
        narrow.curriculum.stage = stage
        narrow.iterate()
        assert narrow.networks.post.log_std.exp().max() <= most + 1e-6
    assert wide.networks.post.log_std.exp().min() > 0.4


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
        "mend",
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


def test_a_deviation_at_its_edge_has_a_gradient(environment):
    """Beyond what is drawn it would have none, and a resumed run could not search again."""
    narrow = Trainer(environment, TrainConfig(rollout=1))
    with torch.no_grad():
        narrow.networks.pre.log_std.fill_(-4.0)
    resumed = Trainer(environment, TrainConfig(rollout=1))
    resumed.load_state_dict(narrow.state_dict())
    log_probability = sample(resumed.networks.pre, torch.randn(8, PRE_STATE_SIZE))[1].sum()
    (gradient,) = torch.autograd.grad(log_probability, resumed.networks.pre.log_std)
    assert (gradient != 0).all()
