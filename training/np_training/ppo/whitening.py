"""Inputs of equal spread without correlation, for a network's training: x' = A (x - m), A = (C + e^2 I)^(-1/2).

Corners of one object move together: half of their directions have less than 2e-4 of the largest variance (the bump, sizes 0.8 to 1.2),
and gradient descent on raw inputs takes long to use them. The map is linear, so the trained network absorbs it in its first layer, and users do not apply it.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import nn


@dataclass(frozen=True)
class Whitening:
    """The map x' = A (x - m) of inputs (..., n)."""

    mean: torch.Tensor
    """m, (n,)."""
    matrix: torch.Tensor
    """A, (n, n), symmetric and positive."""

    @classmethod
    def of(cls, inputs: torch.Tensor, floor: float) -> Whitening:
        """Of inputs (k, n) whose differences below a standard deviation of `floor` carry no information."""
        inputs = inputs.double()
        variances, axes = torch.linalg.eigh(torch.cov(inputs.T))
        matrix = axes * (variances.clamp(min=0) + floor**2).rsqrt() @ axes.T
        return cls(inputs.mean(0), matrix)

    def __call__(self, inputs: torch.Tensor) -> torch.Tensor:
        """Inputs (..., n) as the network receives them in training; their own type."""
        return (inputs - self.mean.to(inputs)) @ self.matrix.to(inputs)

    def put_before(self, layer: nn.Linear) -> None:
        """Change a layer that was trained on whitened inputs so that it gives the same for raw ones."""
        with torch.no_grad():
            weight = layer.weight.double() @ self.matrix
            layer.bias.copy_(layer.bias.double() - weight @ self.mean)
            layer.weight.copy_(weight)

    def take_from(self, layer: nn.Linear) -> None:
        """The inverse of `put_before`: change a layer for raw inputs so that it gives the same for whitened ones."""
        with torch.no_grad():
            layer.bias.copy_(layer.bias.double() + layer.weight.double() @ self.mean)
            layer.weight.copy_(torch.linalg.solve(self.matrix, layer.weight.double().T).T)
