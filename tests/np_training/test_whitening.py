"""Whitened inputs of the student's training."""

import copy

import torch

from np_policy.networks import PreContactNetwork
from np_training.ppo.whitening import Whitening


def correlated(seed: int, count: int = 4000, size: int = 32) -> torch.Tensor:
    """Inputs (count, size) whose standard deviations along the axes of their spread are 1e-5 to 4."""
    generator = torch.Generator().manual_seed(seed)
    axes = torch.linalg.qr(torch.randn(size, size, generator=generator, dtype=torch.float64))[0]
    spread = torch.logspace(-5, 0.6, size, dtype=torch.float64)
    return (torch.randn(count, size, generator=generator, dtype=torch.float64) * spread) @ axes.T + 3.0


def test_whitened_inputs_have_unit_spread_above_the_floor_and_less_below():
    inputs, floor = correlated(1), 1e-2
    spread = torch.linalg.eigvalsh(torch.cov(Whitening.of(inputs, floor)(inputs).T)).sqrt()
    raw = torch.linalg.eigvalsh(torch.cov(inputs.T)).clamp(min=0).sqrt()
    assert torch.allclose(spread.sort().values, (raw / (raw**2 + floor**2).sqrt()).sort().values, atol=1e-6)
    assert spread.max() <= 1


def test_a_layer_takes_the_map_up_and_gives_it_back():
    torch.manual_seed(2)
    inputs = correlated(2).float()
    whiten, network = Whitening.of(inputs, 1e-2), PreContactNetwork()
    first = copy.deepcopy(network)
    with torch.no_grad():
        wanted = network(whiten(inputs))
        whiten.put_before(network.net[0])
        assert (network(inputs) - wanted).abs().max() < 1e-4
        whiten.take_from(network.net[0])
        assert (network(whiten(inputs)) - first(whiten(inputs))).abs().max() < 1e-4


def test_inputs_that_do_not_differ_along_some_axis_are_whitened_to_finite_numbers():
    """Rounding makes the variance along such an axis a small number of either sign, of more than the floor's square."""
    generator = torch.Generator().manual_seed(3)
    inputs = 1e3 * torch.randn(50, 3, generator=generator) @ torch.randn(3, 32, generator=generator)
    variances = torch.linalg.eigvalsh(torch.cov(inputs.double().T))
    floor = 1e-7
    assert variances.min() < -(floor**2)
    assert torch.isfinite(Whitening.of(inputs, floor)(inputs)).all()
