"""The trainer: how a training begins, what of a rollout reaches the learners and the log, what a stage changes, what a checkpoint keeps."""

import dataclasses
from types import SimpleNamespace

import pytest
import torch

from np_description.domains import BUMP, CARD
from np_policy.action import STIFFNESS
from np_training.environment.config import EnvironmentConfig
from np_training.environment.environment import Environment
from np_training.environment.object_poses import PRE_STATE_SIZE
from np_training.ppo import curriculum, distributed
from np_training.ppo.config import TrainConfig
from np_training.ppo.networks import sample
from np_training.ppo.trainer import Trainer
from np_training.reports.releasing import without_optimisers

WORLDS = 16


@pytest.fixture(scope="module")
def simulated() -> Environment:
    """A small environment; its kernels compile once and stay in Warp's cache."""
    return Environment(CARD, "cpu", EnvironmentConfig(worlds=WORLDS, limit=6))


@pytest.fixture
def environment(simulated):
    """The same for every test, with the settings that it was made with."""
    before = simulated.config
    yield simulated
    simulated.config = before


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
    before.post.rate, before.pre.rate = 7e-5, 9e-5
    with torch.no_grad():
        for parameter in before.networks.parameters():
            parameter += 0.01  # else a new training with the same seed has the same
    released = without_optimisers(before.state_dict())
    assert set(released["post"]) == {"rate"}
    after = Trainer(environment, TrainConfig(rollout=1))
    after.load_state_dict(released)
    assert (after.post.rate, after.pre.rate) == pytest.approx((7e-5, 9e-5))
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


def test_a_checkpoint_brings_back_everything_but_the_episodes_under_way(environment, tmp_path):
    before = Trainer(environment, TrainConfig(rollout=1))
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


def seeded(environment, seed):
    """A training begun with a seed, and numbers that depend on what it has drawn."""
    environment.config = dataclasses.replace(environment.config, seed=seed)
    trainer = Trainer(environment)
    weights = [parameter.detach().flatten() for parameter in trainer.networks.parameters()]
    starts = environment.starts.action, environment.objects.position, environment.age.float()
    return torch.cat([*weights, *(tensor.flatten() for tensor in starts)]).clone(), torch.rand(3)


def test_a_training_begun_twice_with_a_seed_is_the_same_and_with_another_seed_another(environment):
    first, second, other = (seeded(environment, seed) for seed in (3, 3, 4))
    assert all(torch.equal(a, b) for a, b in zip(first, second))
    assert not any(torch.equal(a, b) for a, b in zip(first, other))


def test_each_process_and_each_resumption_has_the_random_numbers_of_published_runs(environment, monkeypatch):
    environment.config = dataclasses.replace(environment.config, seed=5)
    state = Trainer(environment).state_dict()
    for rank, iteration, seed in ((0, 0, 5), (2, 0, 20_019), (0, 3, 3_000_014), (2, 3, 3_020_028)):
        monkeypatch.setattr(distributed, "rank", lambda rank=rank: rank)
        Trainer(environment).load_state_dict(state | {"iteration": iteration})
        assert torch.initial_seed() == environment.generator.initial_seed() == seed


def test_a_training_begins_with_contacts_of_its_policy_in_every_world_and_nothing_counted(environment):
    environment.starts = environment.limits = None
    trainer = Trainer(environment)
    assert environment.limits == curriculum.stage_limits(0)
    assert len(environment.starts.state) == 2 * WORLDS, "some are out of reach"
    assert all((state == environment.starts.state).all(-1).any() for state in environment.pre_state)
    counted = "iteration", "steps", "seconds", "stage", "success", "episodes", "recipe_stage", "stage_begun"
    assert {name: trainer.state_dict()[name] for name in counted} == dict.fromkeys(counted, 0)
    assert (trainer.pre.config.epochs, trainer.pre.config.minibatches) == (4, 4)
    assert trainer.post.config == trainer.ppo


def test_episodes_begin_at_every_age_so_that_they_do_not_all_end_in_the_same_step(environment):
    ages = set()
    for seed in range(3):
        environment.config = dataclasses.replace(environment.config, seed=seed)
        Trainer(environment)
        ages |= set(environment.age.tolist())
    assert ages == set(range(environment.config.limit))


def test_all_processes_begin_with_the_networks_of_the_first(environment, monkeypatch):
    def take(networks):
        for parameter in networks.parameters():
            parameter.data.fill_(0.25)

    monkeypatch.setattr(distributed, "share", take)
    trainer = Trainer(environment)
    assert all((parameter == 0.25).all() for parameter in trainer.networks.parameters())


def test_untrained_contacts_are_drawn_anywhere_as_the_curriculum_explores(environment):
    trainer = Trainer(environment, TrainConfig(rollout=1, curriculum=curriculum.CurriculumConfig(explore=1.0)))
    for success, elsewhere in ((0.0, True), (0.6, False)):
        trainer.curriculum.success, trainer.curriculum.episodes = success, 1
        trainer.iterate()
        length = environment.starts.action[:, 6:].norm(dim=-1)
        assert torch.allclose(length, torch.ones(WORLDS), atol=1e-5) == elsewhere


def test_forces_and_episodes_of_a_row_are_those_of_the_domains_own_tasks(environment, monkeypatch):
    environment.config = dataclasses.replace(environment.config, limit=1)  # every step ends every episode
    trainer, reset = Trainer(environment, TrainConfig(rollout=3)), environment.reset

    def begin(where):
        reset(where)
        environment.kind[WORLDS // 2 :] = 1
        environment.force[0] = 1000 + torch.arange(WORLDS)  # N; filtered
        environment.force[1] = 5000  # raw

    monkeypatch.setattr(environment, "reset", begin)
    begin(torch.arange(WORLDS))
    row = trainer.iterate()
    assert row["episodes"] == 3 * WORLDS // 2
    assert (row["force_max"], row["force_median"]) == (1007, 1003.5)
    assert row["length"] == 1 and row["pre_feasible"] == environment.starts.contacts.feasible.float().mean()


def test_success_is_counted_for_each_group_of_tasks_of_the_domains_own(environment):
    trainer = Trainer(environment, TrainConfig(rollout=1))
    no = torch.zeros(5, dtype=torch.bool)
    goals = torch.tensor([BUMP.goals[0].x[0], BUMP.goals[0].y[0], 0.0]).repeat(5, 1)
    trainer.environment = SimpleNamespace(
        domain=BUMP, kind=torch.tensor([0, 0, 0, 0, 1]), age=torch.ones(5), total=torch.ones(5),
        tips=torch.tensor([0, 1, 1, 1, 1]), goals=SimpleNamespace(position=goals),
    )  # fmt: skip
    names = "broken", "lost", "stopped", "pressed", "timeout"
    out = dict.fromkeys(names, no) | {
        "touch": SimpleNamespace(finger=no, bare=no),
        "distance": torch.ones(5),
        "angle": torch.ones(5),
        "terms": {},
    }
    out |= {"done": torch.tensor([1, 1, 1, 0, 1]) > 0, "success": torch.tensor([0, 1, 0, 0, 1]) > 0}
    counts = trainer._count(out)
    found = {name: int(counts[name]) for k in range(3) for name in (f"done_tips{k}", f"success_tips{k}")}
    assert found == {
        "done_tips0": 1, "success_tips0": 0, "done_tips1": 2, "success_tips1": 1, "done_tips2": 0, "success_tips2": 0,
    }  # fmt: skip


def sums_of(done, success, touching=0.0):
    """What a rollout came to in which so many episodes ended."""
    names = "lost stopped pressed timeout length total end_distance end_angle broken overflowed pre_feasible".split()
    return dict.fromkeys(names, 1.0) | {
        "done": done, "success": success, "drawn": 1.0, "touching": touching, "bare": touching, "done_tips1": done,
        "success_tips1": success,
    }  # fmt: skip


def test_a_single_episode_and_a_single_touch_count_as_one(environment):
    row = Trainer(environment, TrainConfig(rollout=1))._row(sums_of(1.0, 1.0, touching=1.0))
    assert row["success"] == row["success_tips1"] == row["bare"] == row["length"] == 1


def test_the_environment_becomes_stricter_when_a_stage_is_won_and_looser_when_one_begins_anew(environment):
    trainer = Trainer(environment, TrainConfig(rollout=1))
    assert trainer._row(sums_of(float(WORLDS), 0.5 * WORLDS))["stage"] == 0
    assert environment.limits == curriculum.stage_limits(0) and environment.config.strictness == 0
    environment.limits = None
    trainer._row(sums_of(1.0, 0.0))
    assert environment.limits is None, "nothing changes within a stage"
    assert trainer._row(sums_of(float(WORLDS), float(WORLDS)))["stage"] == 0, "that in which the rollout was"
    assert environment.limits == curriculum.stage_limits(1) and environment.config.strictness == 1 / 20
    trainer.go_back(7)
    assert environment.limits == curriculum.stage_limits(7) and trainer.curriculum.success == 0
    with pytest.raises(ValueError, match="stage: expected 0 to 10, got 11"):
        trainer.go_back(11)
