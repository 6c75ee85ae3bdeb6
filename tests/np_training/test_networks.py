"""The networks: where an untrained contact points, a share that points anywhere, how actions are drawn, what critics give."""

import math

import pytest
import torch

from np_policy.observation import POST_SIZE
from np_training.environment.environment import PRIVILEGED_SIZE
from np_training.environment.object_poses import PRE_STATE_SIZE
from np_training.ppo.networks import ActorCritic, PreContactActor, distribution, sample


def test_an_untrained_contact_has_fingers_nearly_closed_and_is_on_the_upper_face():
    torch.manual_seed(0)
    actor = PreContactActor()
    mean = actor(torch.randn(200, 18)).mean(0)
    expected = torch.zeros(9)
    expected[3], expected[8] = math.tanh(-1.0), math.tanh(1.0)
    assert (mean - expected).abs().max() < 0.1
    assert torch.equal(actor.log_std, torch.full((9,), -0.7))
    assert actor.net[-1].bias.tolist() == [0, 0, 0, -1, 0, 0, 0, 0, 1]


def test_an_untrained_contact_hardly_depends_on_the_task():
    """The last layer's weights are a tenth of what PyTorch draws, up to 1 over the root of the number of inputs."""
    weight = PreContactActor().net[-1].weight
    assert weight.abs().max().item() == pytest.approx(0.1 / math.sqrt(weight.shape[1]), rel=0.02)


def test_a_critic_has_one_value_for_each_state():
    networks = ActorCritic()
    assert networks.post_value(torch.zeros(3, POST_SIZE + PRIVILEGED_SIZE)).shape == (3, 1)
    assert networks.pre_value(torch.zeros(3, PRE_STATE_SIZE)).shape == (3, 1)


@pytest.mark.parametrize("log_std, drawn", [(-9.0, -3.0), (-1.0, -1.0), (3.0, 0.5)])
def test_actions_are_drawn_within_bounds_of_their_deviation(log_std, drawn):
    actor, state = PreContactActor(), torch.randn(4, PRE_STATE_SIZE)
    with torch.no_grad():
        actor.log_std.fill_(log_std)
    normal = distribution(actor, state)
    assert torch.equal(normal.mean, actor(state))
    assert normal.scale.log().flatten().tolist() == pytest.approx([drawn] * 36)


def test_nothing_waits_for_the_numbers_of_a_distribution():
    """A GPU that is waited for stands still, and a step that waits cannot be captured. Tensors on `meta` have no numbers to wait for."""
    actor, state = PreContactActor().to("meta"), torch.empty(4, PRE_STATE_SIZE, device="meta")
    assert distribution(actor, state).log_prob(torch.empty(4, 9, device="meta")).shape == (4, 9)


def test_states_of_several_steps_are_drawn_for_as_those_of_one():
    torch.manual_seed(0)
    actor, states = PreContactActor(), torch.randn(2, 5, PRE_STATE_SIZE)
    action, log_probability = sample(actor, states)
    assert action.shape == (2, 5, 9) and action.std() > 0.3
    for step in range(2):
        expected = distribution(actor, states[step]).log_prob(action[step]).sum(1)
        torch.testing.assert_close(log_probability[step], expected)


def test_a_share_of_the_contacts_points_anywhere_and_has_the_probability_of_where_it_points():
    torch.manual_seed(0)
    actor, state = PreContactActor(), torch.randn(2000, 18)
    with torch.no_grad():
        actor.log_std.fill_(-3.0)  # none of the policy's own is far from its mean
        own = actor(state)[:, 6:]
    for explore, least, most in ((0.0, 0.0, 0.0), (0.25, 0.2, 0.3), (1.0, 1.0, 1.0)):
        action, log_probability = actor.act(state, explore)
        far = (action[:, 6:] - own).norm(dim=-1) > 0.3
        length = action[:, 6:].norm(dim=-1)
        elsewhere = (length - 1).abs() < 1e-5
        assert least <= elsewhere.float().mean() <= most and (far <= elsewhere).all()
        expected = distribution(actor, state).log_prob(action).sum(-1)
        torch.testing.assert_close(log_probability, expected.detach())
    assert action[:, 6:].mean(0).abs().max() < 0.05, "all directions alike"


def test_without_a_share_no_contact_points_anywhere_whatever_is_drawn(monkeypatch):
    """A random number may be 0 exactly, once in 2^24."""
    torch.manual_seed(0)
    actor = PreContactActor()
    monkeypatch.setattr(torch, "rand", torch.zeros)
    action, _ = actor.act(torch.randn(50, 18), 0.0)
    assert ((action[:, 6:].norm(dim=-1) - 1).abs() > 1e-5).all()
