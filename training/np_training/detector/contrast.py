"""Momentum contrast (He et al., CVPR 2020), which the paper trains its detector with.

Two augmentations of one rendering are to have features nearer to one another than to those of other images:
what the encoder keeps is then what background, light and colour do not change.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from np_training.detector.network import KeypointNetwork, descend


@dataclass(frozen=True)
class ContrastConfig:
    """weight of the InfoNCE loss beside the heatmaps'; size of the features; queue: number of keys that an
    image is contrasted with; temperature; momentum of the keys' encoder."""

    weight: float = 0.1
    size: int = 64
    queue: int = 16384
    temperature: float = 0.1
    momentum: float = 0.99


class Encoder(nn.Module):
    """The downward half of a keypoint network, the mean over its coarsest map, and a head: unit features."""

    def __init__(self, network: KeypointNetwork, size: int) -> None:
        super().__init__()
        width = network.config.widths[-1]
        self.stages = nn.ModuleList(network.downward)
        self.head = nn.Sequential(nn.Linear(width, width), nn.ReLU(inplace=True), nn.Linear(width, size))

    def project(self, coarse: Tensor) -> Tensor:
        """Unit features (n, size) of the coarsest map (n, c, h, w)."""
        return functional.normalize(self.head(coarse.mean((2, 3))).float(), dim=-1)

    def forward(self, images: Tensor) -> Tensor:
        """Unit features (n, size) of images (n, 3, h, w) in [0, 1]."""
        return self.project(descend(self.stages, images)[-1])


class MomentumContrast(nn.Module):
    """The queries' encoder, which shares its weights with the keypoint network, the keys', which follows it,
    and the queue of keys."""

    def __init__(self, network: KeypointNetwork, config: ContrastConfig = ContrastConfig()) -> None:
        super().__init__()
        self.config = config
        self.query = Encoder(network, config.size)
        self.key = copy.deepcopy(self.query).requires_grad_(False)
        queue = functional.normalize(torch.randn(config.queue, config.size), dim=-1)
        self.register_buffer("queue", queue)
        self.register_buffer("place", torch.zeros((), dtype=torch.long))

    @torch.no_grad()
    def keys(self, images: Tensor) -> Tensor:
        """Features (n, size) of the second augmentations; the keys' encoder first follows the queries'."""
        for mine, theirs in zip(self.key.parameters(), self.query.parameters()):
            mine.lerp_(theirs, 1 - self.config.momentum)
        return self.key(images)

    def loss(self, coarse: Tensor, keys: Tensor) -> Tensor:
        """InfoNCE of the queries' coarsest maps (n, c, h, w) and the keys (n, size), which join the queue."""
        query = self.query.project(coarse)
        same = (query * keys).sum(-1, keepdim=True)
        logits = torch.cat([same, query @ self.queue.T], -1) / self.config.temperature
        rows = (self.place + torch.arange(len(keys), device=keys.device)) % len(self.queue)
        # The product above keeps the old queue for its gradient.
        self.queue = self.queue.index_copy(0, rows, keys)
        self.place = (self.place + len(keys)) % len(self.queue)
        return functional.cross_entropy(logits, torch.zeros(len(keys), dtype=torch.long, device=keys.device))
