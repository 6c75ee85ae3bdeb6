"""The learner by hand: advantages, the sign and the clip of the policy's gradient, entropy, critic, learning rate."""

import math
import subprocess
import sys
from copy import deepcopy
from dataclasses import replace

import pytest
import torch
from torch import nn

from np_training.environment.object_poses import PRE_STATE_SIZE
from np_training.ppo import distributed
from np_training.ppo.config import PPOConfig, TrainConfig
from np_training.ppo.curriculum import CurriculumConfig
from np_training.ppo.learner import STATISTICS, Learner, PolicySamples, advantages
from np_training.ppo.networks import ActorCritic, distribution, sample

PLAIN = PPOConfig(epochs=1, minibatches=1, entropy=0.0)


class Gaussian(nn.Module):
    """A policy of one state: mean and deviation are parameters."""

    def __init__(self, mean=0.0, log_std=0.0, actions=1):
        super().__init__()
        self.mean = nn.Parameter(torch.full((actions,), mean))
        self.log_std = nn.Parameter(torch.full((actions,), log_std))

    def forward(self, state):
        return self.mean.expand(len(state), -1)


class Constant(nn.Module):
    """A critic that expects the same everywhere."""

    def __init__(self, value=0.0):
        super().__init__()
        self.value = nn.Parameter(torch.tensor([value]))

    def forward(self, state):
        return self.value.expand(len(state), 1)


def batch_of(policy, action, advantage, ratio=1.0, returns=None):
    """Samples whose probability was that of the policy now over `ratio`."""
    state = torch.zeros(len(action), 1)
    with torch.no_grad():
        now = distribution(policy, state).log_prob(action).sum(-1)
    returns = torch.zeros(len(action)) if returns is None else returns
    return PolicySamples(state, state, action, now - torch.as_tensor(ratio).log(), advantage, returns)


def gradients(policy, batch, config=PLAIN, critic=None):
    """Gradients of the policy's loss and the critic's, by parameter, and the statistics; the advantages count as they are."""
    learner = Learner(policy, critic or Constant(), config)
    with torch.no_grad():
        normal = distribution(policy, batch.state)
    share = torch.full((len(batch.state),), 1 / len(batch.state))
    learner._gradients(*batch.columns(), normal.mean, normal.scale[:1], share)
    statistics, *parts = learner._message.split([len(STATISTICS), *(p.numel() for p in learner._parameters)])
    names = [*dict(policy.named_parameters()), "value"]
    return dict(zip(names, parts)), dict(zip(STATISTICS, statistics.tolist()))


def summed_advantages(reward, done, value, last, discount, trace):
    """sum over k of (discount trace)^k delta_(t+k), until an end: the definition, as a double loop."""
    steps = len(reward)
    following = [*value[1:], last]
    result = []
    for t in range(steps):
        total, weight = 0.0, 1.0
        for k in range(t, steps):
            alive = 0.0 if done[k] else 1.0
            total += weight * (reward[k] + discount * alive * following[k] - value[k])
            if done[k]:
                break
            weight *= discount * trace
        result.append(total)
    return result


def test_advantages_of_two_steps_by_hand():
    # delta: 1 + .9 * 3 - 2 = 1.7; 0 + .9 * 4 - 3 = .6; advantage of the first: 1.7 + .9 * .5 * .6 = 1.97
    config = PPOConfig(discount=0.9, trace=0.5)
    column = [torch.tensor([[a], [b]]) for a, b in ((1.0, 0.0), (2.0, 3.0))]
    found = advantages(config, column[0], torch.zeros(2, 1, dtype=torch.bool), column[1], torch.tensor([4.0]))
    assert found[:, 0].tolist() == pytest.approx([1.97, 0.6])


@pytest.mark.parametrize("discount, trace", [(0.99, 0.95), (0.9, 0.0), (0.9, 1.0), (1.0, 0.5)])
def test_advantages_are_the_weighted_sums_of_their_definition(discount, trace):
    generator = torch.Generator().manual_seed(0)
    reward, value = torch.randn(2, 9, 5, generator=generator)
    done = torch.rand(9, 5, generator=generator) < 0.25
    done[:, 0], done[-1, 1] = False, True
    last = torch.randn(5, generator=generator)
    found = advantages(PPOConfig(discount=discount, trace=trace), reward, done, value, last)
    for n in range(5):
        columns = (tensor[:, n].tolist() for tensor in (reward, done, value))
        assert found[:, n].tolist() == pytest.approx(
            summed_advantages(*columns, float(last[n]), discount, trace), abs=1e-5
        )


def test_the_defaults_are_those_that_recipes_count_on():
    config = PPOConfig()
    assert (config.discount, config.trace, config.clip) == (0.99, 0.95, 0.2)
    assert (config.epochs, config.minibatches, config.entropy, config.target_kl) == (5, 8, 0.0005, 0.01)
    assert (config.rate, config.gradient_norm) == ((2e-5, 1e-3), 1.0)
    config = TrainConfig()
    assert (config.rollout, config.hold, config.tolerance, config.reflex) == (12, 3, 1.0, True)
    assert (config.pre_least, config.stiffness, config.deviation) == (64, 0.0, None)
    config = CurriculumConfig()
    assert (config.residual, config.advance_at, config.growth, config.practised_at) == (True, 0.8, 10, 0.6)
    assert (config.practice, config.explore, config.kept, config.least_weight) == (0.0, 0.0, 0.0, 0.03)


def test_settings_are_read_without_pytorch():
    """A command that only says what its options are does not wait for it."""
    code = "import sys, np_training.ppo.config, np_training.tasks.rewards; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.mark.parametrize("better", (-1.0, 1.0))
def test_of_two_arms_the_better_one_becomes_likelier(better):
    policy = Gaussian()
    arms = torch.tensor([[-1.0], [1.0]]).repeat(32, 1)
    batch = batch_of(policy, arms, (arms[:, 0] == better).float())
    arm = torch.tensor([[better]])
    before = distribution(policy, torch.zeros(1, 1)).log_prob(arm).item()
    Learner(policy, Constant(), PLAIN).update(batch)
    assert distribution(policy, torch.zeros(1, 1)).log_prob(arm).item() > before
    assert math.copysign(1, policy.mean.item()) == better


@pytest.mark.parametrize("ratio, advantage, moves", [
    (1.0, 1.0, True), (1.0, -1.0, True),
    (1.3, 1.0, False), (1.3, -1.0, True),
    (0.7, 1.0, True), (0.7, -1.0, False),
    (1.15, 1.0, True), (0.85, -1.0, True),
])  # fmt: skip
def test_beyond_the_clip_only_a_way_back_has_a_gradient(ratio, advantage, moves):
    policy, action = Gaussian(), torch.tensor([[0.5]])
    found, statistics = gradients(policy, batch_of(policy, action, torch.tensor([advantage]), ratio))
    # Of ratio A: d/d mean = ratio A (action - mean) / std^2.
    expected = -ratio * advantage * 0.5 if moves else 0.0
    assert found["mean"].item() == pytest.approx(expected, abs=1e-6)
    clipped = min(max(ratio, 0.8), 1.2)
    assert statistics["policy_loss"] == pytest.approx(-min(ratio * advantage, clipped * advantage))


def test_an_action_that_has_become_certain_or_impossible_leaves_the_update_finite():
    """exp of 200 overflows: infinity times an advantage of 0 would spoil every parameter."""
    for log_probability in (-200.0, 200.0):
        policy, action = Gaussian(), torch.tensor([[0.5]])
        batch = replace(batch_of(policy, action, torch.tensor([0.0])), log_probability=torch.tensor([log_probability]))
        found, statistics = gradients(policy, batch)
        assert all(torch.isfinite(gradient).all() for gradient in found.values())
        assert math.isfinite(statistics["policy_loss"])


def test_no_action_counts_as_more_than_e_to_the_20_times_as_likely_as_it_was():
    policy, action = Gaussian(), torch.tensor([[0.5]])
    batch = replace(batch_of(policy, action, torch.tensor([-1.0])), log_probability=torch.tensor([-60.0]))
    assert gradients(policy, batch)[1]["policy_loss"] == pytest.approx(485165195.4, rel=1e-5)


def test_the_probability_of_an_action_is_that_of_all_its_parts():
    policy, action = Gaussian(actions=2), torch.tensor([[0.5, -0.25]])
    batch = batch_of(policy, action, torch.tensor([1.0]))
    with torch.no_grad():
        policy.mean += 0.1  # ratio: exp of the sum over both parts of ((a - 0)^2 - (a - .1)^2) / 2
    found, statistics = gradients(policy, batch)
    ratio = math.exp((0.5**2 - 0.4**2 + 0.25**2 - 0.35**2) / 2)
    assert statistics["policy_loss"] == pytest.approx(-ratio)
    assert found["mean"].tolist() == pytest.approx([-ratio * 0.4, ratio * 0.35])


def test_the_bonus_widens_the_policy_by_its_weight():
    policy, config = Gaussian(), replace(PLAIN, entropy=0.25)
    found, statistics = gradients(policy, batch_of(policy, torch.tensor([[0.5]]), torch.tensor([0.0])), config)
    # The entropy of a Gaussian is log std + (1 + log 2 pi) / 2: its slope is 1, the loss has it with a minus.
    entropy = 0.5 * (1 + math.log(2 * math.pi))
    assert found["log_std"].item() == pytest.approx(-0.25)
    assert statistics["entropy"] == pytest.approx(entropy)
    assert statistics["policy_loss"] == pytest.approx(-0.25 * entropy)


def test_the_critic_goes_to_the_returns():
    policy, critic = Gaussian(), Constant(1.0)
    batch = batch_of(policy, torch.zeros(2, 1), torch.zeros(2), returns=torch.tensor([2.0, 6.0]))
    found, statistics = gradients(policy, batch, critic=critic)
    assert found["value"].item() == pytest.approx(2 * (1 - 4))  # of the mean square
    assert statistics["value_loss"] == pytest.approx((1 + 25) / 2)
    learner = Learner(policy, critic, PLAIN)
    learner.update(batch)
    assert critic.value.item() > 1.0


def test_advantages_are_centred_and_scaled_before_an_update():
    shifted = [torch.tensor(values) for values in ([1.0, -1.0, 1.0, -1.0], [25.0, 5.0, 25.0, 5.0])]
    found = []
    for advantage in shifted:
        policy = Gaussian()
        learner = Learner(policy, Constant(), replace(PLAIN, clip=10.0))
        action = torch.tensor([[1.0], [0.3], [-0.2], [-1.0]])
        said = learner.update(batch_of(policy, action, advantage, torch.tensor([1.0, 1.1, 0.9, 1.2])))
        found.append((said["policy_loss"], *learner._message[len(STATISTICS) :].tolist()))
    assert found[0] == pytest.approx(found[1], rel=1e-4, abs=1e-6)
    assert found[0][0] == pytest.approx(-(1.0 - 1.1 + 0.9 - 1.2) / 4, rel=1e-4)


def test_the_divergence_is_that_of_the_policy_from_before_to_now():
    policy = Gaussian(mean=0.5, log_std=math.log(0.5))
    learner = Learner(policy, Constant(), PLAIN)
    batch = batch_of(policy, torch.tensor([[0.0]]), torch.tensor([1.0]))
    learner._gradients(*batch.columns(), torch.tensor([[0.2]]), torch.tensor([[0.4]]), torch.ones(1))
    now, old = torch.distributions.Normal(0.5, 0.5), torch.distributions.Normal(0.2, 0.4)
    expected = torch.distributions.kl_divergence(now, old).item()
    assert learner._message[STATISTICS.index("kl")].item() == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("kl, factor", [(0.021, 1 / 1.5), (0.019, 1.0), (0.006, 1.0), (0.004, 1.5), (0.0, 1.0)])
def test_the_rate_falls_where_the_policy_moves_far_and_rises_where_it_hardly_moves(kl, factor):
    learner = Learner(Gaussian(), Constant(), PPOConfig(target_kl=0.01), rate=3e-4)
    learner._steer(torch.tensor(kl))
    assert learner.rate == pytest.approx(factor * 3e-4)


@pytest.mark.parametrize("kl", [0.125, 0.5])
def test_at_half_and_at_twice_the_divergence_that_is_aimed_at_the_rate_stays(kl):
    learner = Learner(Gaussian(), Constant(), PPOConfig(target_kl=0.25), rate=3e-4)
    learner._steer(torch.tensor(kl))
    assert learner.rate == pytest.approx(3e-4)


@pytest.mark.parametrize("kl, bound", [(1.0, 2e-5), (1e-6, 1e-3)])
def test_the_rate_stays_within_its_bounds(kl, bound):
    learner = Learner(Gaussian(), Constant(), PPOConfig(rate=(2e-5, 1e-3)))
    for _ in range(20):
        learner._steer(torch.tensor(kl))
    assert learner.rate == pytest.approx(bound)


def test_an_update_goes_through_every_sample_once_an_epoch(monkeypatch):
    policy, seen = Gaussian(), []
    learner = Learner(policy, Constant(), PPOConfig(epochs=3, minibatches=4))
    reckon = learner._reckon
    monkeypatch.setattr(learner, "_reckon", lambda *tensors: (seen.append(tensors[2][:, 0]), reckon(*tensors)))
    action = torch.linspace(-1, 1, 10)[:, None]
    said = learner.update(batch_of(policy, action, torch.randn(10), returns=torch.ones(10)))
    assert len(seen) == 12
    assert [len(rows) for rows in seen[:4]] == [3, 3, 2, 2]
    assert said["value_loss"] == pytest.approx(1.0, abs=0.02), "each counts by its share of its minibatch"
    for epoch in range(3):
        drawn = torch.cat(seen[4 * epoch : 4 * epoch + 4]).sort().values
        assert torch.equal(drawn, action[:, 0])


def test_a_step_is_no_longer_than_the_bound_of_the_gradient():
    """Adam's first step hides the gradient's size; its memory does not."""
    policy = Gaussian(log_std=-2.0)
    learner = Learner(policy, Constant(), replace(PLAIN, gradient_norm=0.5))
    learner.update(batch_of(policy, torch.tensor([[0.5], [-0.3]]), torch.tensor([1.0, -1.0])))
    kept = [learner.policy_optimiser.state[p]["exp_avg"] for p in policy.parameters()]
    assert torch.cat(kept).norm().item() == pytest.approx(0.1 * 0.5, rel=1e-3)


def test_the_first_step_is_as_long_as_the_rate_and_shorter_where_the_gradient_is_as_small_as_adams_epsilon():
    policy, critic = Gaussian(), Constant()
    # Of the critic's loss 2 (0 - 5e-6) = -1e-5 is the slope: with an epsilon of 1e-5 Adam goes half of its rate.
    batch = batch_of(policy, torch.tensor([[1.0], [-1.0]]), torch.tensor([1.0, -1.0]), returns=torch.full((2,), 5e-6))
    Learner(policy, critic, PLAIN).update(batch)
    assert policy.mean.item() == pytest.approx(3e-4, rel=1e-3)
    assert critic.value.item() == pytest.approx(2.5e-4, rel=1e-3)


def test_statistics_are_those_of_one_update():
    policy, critic = Gaussian(), Constant()
    learner = Learner(policy, critic, PLAIN)
    batch = batch_of(policy, torch.zeros(2, 1), torch.zeros(2), returns=torch.ones(2))
    first, second = learner.update(batch), learner.update(batch)
    assert first["value_loss"] == pytest.approx(1.0)
    assert second["value_loss"] == pytest.approx((1 - 5e-4) ** 2, rel=1e-5)


def test_minibatches_of_one_sample_or_none_count_as_their_samples_do():
    batch = batch_of(Gaussian(), torch.zeros(2, 1), torch.zeros(2), returns=torch.ones(2))
    said = Learner(Gaussian(), Constant(), PPOConfig(epochs=1, minibatches=4)).update(batch)
    assert said["value_loss"] == pytest.approx((1 + 1 + 0 + 0) / 4, rel=1e-2)


def test_advantages_that_differ_by_rounding_alone_are_not_blown_up():
    policy = Gaussian()
    batch = batch_of(policy, torch.tensor([[1.0], [-1.0]]), torch.tensor([1e-6, -1e-6]), torch.tensor([1.1, 0.9]))
    said = Learner(policy, Constant(), PLAIN).update(batch)
    assert said["policy_loss"] == pytest.approx(-0.5 * (1.1 - 0.9) / 2, rel=1e-3)  # 1e-6 over 1e-6 + 1e-6


def test_a_learner_goes_on_from_what_another_has_kept():
    generator = torch.Generator().manual_seed(0)
    action, advantage, returns = (torch.randn(*shape, generator=generator) for shape in ((20, 1), (20,), (20,)))
    config = PPOConfig(epochs=2, minibatches=2, rate=(2e-5, 1e-1))
    first, second = ((Gaussian(), Constant()) for _ in range(2))
    learner, other = Learner(*first, config), Learner(*second, config)
    learner.update(batch_of(first[0], action, advantage, returns=returns))
    other.load_state_dict(deepcopy(learner.state_dict()))
    kept = learner.rate
    assert other.rate == kept != pytest.approx(3e-4)
    for mine, theirs in zip(second, first):
        mine.load_state_dict(theirs.state_dict())
    for networks, one in ((first, learner), (second, other)):
        torch.manual_seed(1)
        one.update(batch_of(networks[0], action, advantage, returns=returns))
    for mine, theirs in zip(second, first):
        assert all(torch.equal(a, b) for a, b in zip(mine.parameters(), theirs.parameters()))
    assert other.rate == learner.rate != kept


def test_a_checkpoint_of_a_gpu_goes_on_on_a_cpu():
    policy, critic = Gaussian(), Constant()
    learner, batch = Learner(policy, critic, PLAIN), batch_of(policy, torch.zeros(2, 1), torch.zeros(2))
    learner.update(batch)
    state = deepcopy(learner.state_dict())
    for optimiser in state.values():
        optimiser["param_groups"][0] |= {"capturable": True, "fused": False}  # the first is for a GPU alone
    state["policy"]["param_groups"][0]["lr"] = 7e-5  # a number, as an optimiser without steering has it
    learner.load_state_dict(state)
    learner.update(batch)
    assert learner.rate == pytest.approx(7e-5)
    for optimiser in (learner.policy_optimiser, learner.critic_optimiser):
        assert optimiser.param_groups[0]["fused"] and not optimiser.param_groups[0]["capturable"]


def test_a_step_captured_with_the_memory_of_before_is_not_replayed_with_that_of_a_checkpoint():
    """A graph on a GPU holds the addresses of the optimisers' tensors."""
    learner = Learner(Gaussian(), Constant(), PLAIN)
    learner.update(batch_of(learner.policy, torch.zeros(2, 1), torch.zeros(2)))
    captured, state = learner._step, deepcopy(learner.state_dict())
    learner.load_state_dict(state)
    assert learner._step is not captured and learner._step.function == learner._descend


def test_processes_that_have_the_same_samples_learn_what_one_of_them_does(monkeypatch):
    generator = torch.Generator().manual_seed(0)
    action, advantage, returns = (torch.randn(*shape, generator=generator) for shape in ((20, 1), (20,), (20,)))
    ended = []
    for processes in (1, 3):
        monkeypatch.setattr(distributed, "add", lambda *tensors: [tensor.mul_(processes) for tensor in tensors])
        torch.manual_seed(1)
        policy, critic = Gaussian(), Constant()
        learner = Learner(policy, critic, PPOConfig(epochs=2, minibatches=3))
        said = learner.update(batch_of(policy, action, advantage, torch.rand(20) + 0.5, returns))
        ended.append([*said.values(), learner.rate, policy.mean.item(), policy.log_std.item(), critic.value.item()])
    assert ended[0] == pytest.approx(ended[1], rel=1e-4)


def test_a_release_that_holds_a_learning_rate_alone_leaves_the_optimiser_new():
    learner = Learner(Gaussian(), Constant(), PLAIN)
    learner.load_state_dict({"rate": 7e-5})
    assert learner.rate == pytest.approx(7e-5) and not learner.policy_optimiser.state


def test_advantages_are_the_returns_where_lambda_and_the_values_say_so():
    config = PPOConfig(discount=0.9, trace=1.0)
    reward = torch.tensor([[1.0], [2.0], [3.0]])
    done = torch.tensor([[False], [True], [False]])
    gain = advantages(config, reward, done, torch.zeros(3, 1), torch.tensor([10.0]))
    assert torch.allclose(gain[:, 0], torch.tensor([1 + 0.9 * 2, 2.0, 3 + 0.9 * 10]))


def test_rows_that_fill_a_minibatch_up_count_for_nothing():
    def updated(filled: bool) -> tuple[list[torch.Tensor], dict[str, float]]:
        torch.manual_seed(3)
        networks = ActorCritic()
        learner = Learner(networks.pre, networks.pre_value, PPOConfig(epochs=2, minibatches=3))
        learner._captures, reckon = filled, learner._reckon  # as on a GPU, where shapes have to be few
        learner._reckon = lambda *columns: (lengths.add(len(columns[0])), reckon(*columns))
        state = torch.randn(100, PRE_STATE_SIZE)
        action, log_probability = sample(networks.pre, state)
        figures = learner.update(
            PolicySamples(state, state, action.detach(), log_probability.detach(), torch.randn(100), torch.randn(100))
        )
        return [p.detach() for p in networks.parameters()], figures

    lengths = set()
    plain, figures = updated(False)
    assert lengths == {33, 34}
    lengths.clear()
    filled, same = updated(True)
    assert lengths == {2048}
    assert all((a - b).abs().max() < 1e-5 for a, b in zip(plain, filled))
    assert same == pytest.approx(figures, rel=1e-3, abs=1e-6)
