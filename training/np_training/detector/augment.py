"""From renderings to training images: background, edges, light, colour, blur, noise. All on the device, in
batches.

Background and table are replaced by one random colour or a procedural texture, as in the paper (Kim et al.,
IROS 2023), or kept, with their shadows, because the deployed images have them.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from np_training.detector.render import OVERSAMPLING, Frames


@dataclass(frozen=True)
class Augmentation:
    """coloured, textured: shares of images whose surroundings become one colour or a texture; shaded: share
    of those that keep light and shadow; aliased: share of images without smoothed edges; contrast, gamma,
    tint: spread around 1; brightness: spread around 0; blurred: share of blurred images; blur: largest sigma
    px; noise: largest sigma."""

    coloured: float = 0.3
    textured: float = 0.3
    shaded: float = 0.5
    aliased: float = 0.35
    contrast: float = 0.25
    gamma: float = 0.25
    tint: float = 0.08
    brightness: float = 0.12
    blurred: float = 0.35
    blur: float = 1.2
    noise: float = 0.04


def augment(frames: Frames, generator: torch.Generator, config: Augmentation = Augmentation()) -> tuple[Tensor, Tensor]:
    """Images (n, 3, 224, 224) in [0, 1] in steps of 1/255, and the pixels (n, 8, 2) of the corners in
    them."""
    images, surroundings, shift = reduce(frames, generator, config)
    images = replace_background(images, surroundings, generator, config)
    images = photometric(images, generator, config)
    return (images * 255).round_().div_(255), frames.pixels - shift[:, None]


def reduce(frames: Frames, generator: torch.Generator, config: Augmentation) -> tuple[Tensor, Tensor, Tensor]:
    """Camera resolution: images (n, 3, h, w), share of surroundings (n, 1, h, w), shift (n, 2) px of the
    content.

    Smooth edges are the mean of OVERSAMPLING^2 renderings' pixels, rough ones (a ray caster with one ray a
    pixel) are one of them, which lies off the centre of the pixel by `shift`.
    """
    count, device, n = len(frames.rgb), frames.rgb.device, OVERSAMPLING
    choice = torch.randint(0, n, (2, count), generator=generator, device=device)
    rough = torch.rand(count, generator=generator, device=device) < config.aliased
    one = functional.one_hot(choice, n).to(frames.rgb.dtype)
    weights = torch.where(rough[:, None, None], one[1][:, :, None] * one[0][:, None, :], 1 / n**2)  # rows, columns
    height, width = frames.rgb.shape[1] // n, frames.rgb.shape[2] // n
    cells = frames.rgb.view(count, height, n, width, n, 3)
    images = torch.einsum("nyaxbc,nab->ncyx", cells, weights)
    outside = frames.surroundings.view(count, height, n, width, n).to(weights.dtype)
    surroundings = torch.einsum("nyaxb,nab->nyx", outside, weights)[:, None]
    offset = (choice.to(weights.dtype) + 0.5) / n - 0.5
    return images, surroundings, torch.where(rough[:, None], offset.T, torch.zeros_like(offset.T))


def replace_background(
    images: Tensor, surroundings: Tensor, generator: torch.Generator, config: Augmentation
) -> Tensor:
    """Images whose surroundings (share of each pixel (n, 1, h, w)) are a random colour, a texture, or as they
    were."""
    count, device = len(images), images.device
    kind = torch.rand(count, 1, 1, 1, generator=generator, device=device)
    colour = torch.rand(count, 3, 1, 1, generator=generator, device=device)
    texture = procedural_texture(count, images.shape[2:], generator)
    new = torch.where(kind < config.coloured, colour, texture)
    # Light and shadow on the table, relative to its brightest parts.
    luminance = images.mean(dim=1, keepdim=True) * surroundings
    shading = (luminance / luminance.amax(dim=(2, 3), keepdim=True).clamp(min=1e-3)).clamp(0, 1)
    shaded = torch.rand(count, 1, 1, 1, generator=generator, device=device) < config.shaded
    new = torch.where(shaded, new * shading, new * surroundings)
    # A pixel on an edge keeps what the object gives it; the table's part is its nearest guess, its own share.
    kept = images * (1 - surroundings)
    replaced = kept + new
    return torch.where(kind < config.coloured + config.textured, replaced, images)


def procedural_texture(count: int, size: tuple[int, int], generator: torch.Generator) -> Tensor:
    """Textures (count, 3, *size) in [0, 1]: value noise at four scales, smooth or in blocks, between random
    colours."""
    device = generator.device
    low, high, total = (torch.rand(count, 3, 1, 1, generator=generator, device=device) for _ in range(3))
    noise = torch.zeros(count, 3, *size, device=device)
    weight_sum = torch.zeros(count, 1, 1, 1, device=device)
    blocky = torch.rand(count, 1, 1, 1, generator=generator, device=device) < 0.4
    for cells in (4, 11, 29, 73):
        values = torch.rand(count, 3, cells, cells, generator=generator, device=device)
        # Mostly one pattern in all three channels, sometimes three.
        values = torch.where(total[:, :1] < 0.6, values[:, :1].expand_as(values), values)
        smooth = functional.interpolate(values, size=size, mode="bilinear", align_corners=False)
        rough = functional.interpolate(values, size=size, mode="nearest")
        weight = torch.rand(count, 1, 1, 1, generator=generator, device=device) ** 2
        noise += weight * torch.where(blocky, rough, smooth)
        weight_sum += weight
    noise = ((noise / weight_sum.clamp(min=1e-3) - 0.5) * 2 + 0.5).clamp(0, 1)
    return low + (high - low) * noise


def photometric(images: Tensor, generator: torch.Generator, config: Augmentation) -> Tensor:
    """Gamma, tint, contrast, brightness, blur and noise; images (n, 3, h, w) in [0, 1], and so is the
    result."""
    count, device = len(images), images.device

    def spread(width: float, channels: int = 1) -> Tensor:
        return width * (2 * torch.rand(count, channels, 1, 1, generator=generator, device=device) - 1)

    images = images.clamp(1e-4, 1) ** (1 + spread(config.gamma)) * (1 + spread(config.tint, 3))
    mean = images.mean(dim=(1, 2, 3), keepdim=True)
    images = (images - mean) * (1 + spread(config.contrast)) + mean + spread(config.brightness)
    images = gaussian_blur(images, _blur_sigma(count, generator, config))
    sigma = config.noise * torch.rand(count, 1, 1, 1, generator=generator, device=device) ** 2
    return (images + sigma * torch.randn(images.shape, generator=generator, device=device)).clamp_(0, 1)


def _blur_sigma(count: int, generator: torch.Generator, config: Augmentation) -> Tensor:
    chosen = torch.rand(count, generator=generator, device=generator.device) < config.blurred
    return chosen * config.blur * torch.rand(count, generator=generator, device=generator.device)


def gaussian_blur(images: Tensor, sigma: Tensor) -> Tensor:
    """Images (n, c, h, w) blurred by sigma (n,) px each; sigma 0 changes nothing."""
    radius = 3  # px
    offset = torch.arange(-radius, radius + 1, device=images.device, dtype=images.dtype)
    kernel = torch.exp(-0.5 * (offset / sigma.clamp(min=1e-3)[:, None]) ** 2)
    kernel = kernel / kernel.sum(dim=1, keepdim=True)
    padded = functional.pad(images, (radius,) * 4, mode="replicate")
    width, height = images.shape[3], images.shape[2]
    rows = sum(kernel[:, i, None, None, None] * padded[..., i : i + width] for i in range(2 * radius + 1))
    return sum(kernel[:, i, None, None, None] * rows[..., i : i + height, :] for i in range(2 * radius + 1))
