"""The contact policy's network: where an untrained one points, and a share that points anywhere."""

import math

import torch

from np_training.ppo.networks import PreContactActor, distribution


def test_an_untrained_contact_has_fingers_nearly_closed_and_is_on_the_upper_face():
    torch.manual_seed(0)
    actor = PreContactActor()
    mean = actor(torch.randn(200, 18)).mean(0)
    expected = torch.zeros(9)
    expected[3], expected[8] = math.tanh(-1.0), math.tanh(1.0)
    assert (mean - expected).abs().max() < 0.1
    assert torch.equal(actor.log_std, torch.full((9,), -0.7))


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
