"""The keypoint network: image to one heatmap and one score per box corner, decoded to pixels inside the
network.

A small U-Net with full-resolution heatmaps, the form of S3K (Vecerik et al., CoRL 2020) that the paper uses.
It works at half resolution and below; the last layer holds the four pixels of each 2 x 2 cell as channels
(Shi et al., CVPR 2016), so that full resolution costs next to nothing on a CPU.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from np_description.keypoints import COUNT

RELIABLE = 3.0  # px: a score is the probability that its keypoint is this near to the true corner


@dataclass(frozen=True)
class NetworkConfig:
    """widths: channels at 1/2, 1/4, 1/8, ... of the image; blocks: residual blocks at each level below the
    first; window: half width px of the soft-argmax around a heatmap's peak."""

    widths: tuple[int, ...] = (32, 32, 64, 96)
    blocks: tuple[int, ...] = (1, 2, 2)
    window: int = 5


class Keypoints(NamedTuple):
    """logits (n, 8, height, width) of the heatmaps; pixels (n, 8, 2) u, v px; score_logits (n, 8)."""

    logits: Tensor
    pixels: Tensor
    score_logits: Tensor


def convolution(inputs: int, outputs: int, stride: int = 1, size: int = 3) -> nn.Sequential:
    """Convolution, batch normalisation, rectifier."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, size, stride, (size - 1) // 2, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


class Residual(nn.Module):
    """Two 3 x 3 convolutions around which the input is added."""

    def __init__(self, width: int):
        super().__init__()
        self.first = convolution(width, width)
        self.second = nn.Sequential(nn.Conv2d(width, width, 3, 1, 1, bias=False), nn.BatchNorm2d(width))

    def forward(self, x: Tensor) -> Tensor:
        """Features (n, width, h, w) to the same."""
        return functional.relu(x + self.second(self.first(x)))


class KeypointNetwork(nn.Module):
    """RGB images (n, 3, height, width) in [0, 1], sides a multiple of 2 ** levels, to `Keypoints`."""

    def __init__(self, config: NetworkConfig = NetworkConfig()):
        super().__init__()
        self.config = config
        widths = config.widths
        self.stem = convolution(3, widths[0], stride=2, size=5)
        self.down = nn.ModuleList(
            nn.Sequential(convolution(a, b, stride=2), *(Residual(b) for _ in range(count)))
            for a, b, count in zip(widths, widths[1:], config.blocks)
        )
        self.narrow = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in zip(widths, widths[1:]))
        self.merge = nn.ModuleList(convolution(a, a) for a in widths[:-1])
        self.heatmap = nn.Conv2d(widths[0], 4 * COUNT, 1)
        self.score = nn.Conv2d(widths[1], COUNT, 1)

    def forward(self, image: Tensor) -> Keypoints:
        """Heatmaps, pixels and scores of a batch of images."""
        return self.read(self.encode(image))

    def encode(self, image: Tensor) -> list[Tensor]:
        """Maps (n, width, h, w) at 1/2, 1/4, ... of the image."""
        return descend(self.downward, image)

    @property
    def downward(self) -> list[nn.Module]:
        """The stages of `encode`, finest first."""
        return [self.stem, *self.down]

    def read(self, levels: list[Tensor]) -> Keypoints:
        """Keypoints from the maps that `encode` gave."""
        x = levels[-1]
        for i in reversed(range(len(self.merge))):
            if i == 0:
                scores = self.score(x).float()
            x = functional.interpolate(self.narrow[i](x), scale_factor=2.0, mode="nearest")
            x = self.merge[i](levels[i] + x)
        logits = functional.pixel_shuffle(self.heatmap(x), 2).float()
        peak = find_peak(logits)
        # The score is read off its map, at a quarter of the resolution, where the keypoint is estimated.
        cell = torch.div(peak, 4, rounding_mode="floor")
        cell = cell[..., 0] * scores.shape[3] + cell[..., 1]
        score_logits = scores.flatten(2).gather(2, cell[..., None])[..., 0]
        return Keypoints(logits, decode(logits, peak, self.config.window), score_logits)


def descend(stages: Iterable[nn.Module], image: Tensor) -> list[Tensor]:
    """What each of the stages makes of the one before it, the first of an image (n, 3, h, w) in [0, 1]."""
    levels = [image - 0.5]
    for stage in stages:
        levels.append(stage(levels[-1]))
    return levels[1:]


def find_peak(logits: Tensor) -> Tensor:
    """Row and column (n, 8, 2) of the largest value of each heatmap (n, 8, height, width)."""
    index = logits.flatten(2).argmax(dim=-1)
    width = logits.shape[3]
    return torch.stack([torch.div(index, width, rounding_mode="floor"), index % width], dim=-1)


def decode(logits: Tensor, peak: Tensor, window: int) -> Tensor:
    """Pixels (n, 8, 2), u and v, from heatmaps (n, 8, height, width) and their peaks (n, 8, 2).

    The mean of the softmax within `window` px of the peak: sub-pixel, and blind to other modes. At the border
    the window is moved inwards.
    """
    height, width = logits.shape[2:]
    offset = torch.arange(-window, window + 1, device=logits.device)
    rows = peak[..., :1].clamp(window, height - 1 - window) + offset
    columns = peak[..., 1:].clamp(window, width - 1 - window) + offset
    index = (rows[..., :, None] * width + columns[..., None, :]).flatten(2)
    weights = logits.flatten(2).gather(2, index).softmax(dim=-1).unflatten(2, (2 * window + 1, 2 * window + 1))
    u = (weights.sum(dim=2) * columns).sum(dim=-1)
    v = (weights.sum(dim=3) * rows).sum(dim=-1)
    return torch.stack([u, v], dim=-1)


def heatmap_loss(logits: Tensor, truth: Tensor, sigma: float) -> Tensor:
    """Divergence (n, 8) of heatmaps (logits (n, 8, h, w)) from Gaussians of `sigma` px at truth (n, 8, 2), up
    to a constant.

    KL(target || softmax) less the target's entropy (Kim et al., IROS 2023). The Gaussian is separable, so the
    target's map is never built.
    """
    height, width = logits.shape[2:]

    def axis(centre: Tensor, size: int) -> Tensor:
        offset = torch.arange(size, device=logits.device, dtype=logits.dtype) - centre[..., None]
        return (-0.5 * (offset / sigma) ** 2).softmax(dim=-1)

    columns, rows = axis(truth[..., 0], width), axis(truth[..., 1], height)
    expected = torch.einsum("nkh,nkhw,nkw->nk", rows, logits, columns)
    return logits.flatten(2).logsumexp(dim=-1) - expected
