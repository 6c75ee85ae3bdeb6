"""Endless labelled training images."""

from __future__ import annotations

import torch
from torch import Tensor

from np_description.camera import CAMERA
from np_description.domains import Domain
from np_training.detector.augment import augment
from np_training.detector.render import SceneRenderer
from np_training.detector.scenes import sample_states

LEAST_AREA = 12.0  # px of the object: below it, where the corners are cannot be asked


class Samples:
    """Endless labelled images: (images (n, 3, 224, 224), pixels (n, 8, 2), visible (n, 8), present (n, 8)).

    A corner is present if it lies inside an image that shows something of the object: hidden ones are to be
    inferred.
    """

    def __init__(
        self, domain: Domain, renderer: SceneRenderer, pool: int, generator: torch.Generator
    ) -> None:
        self.domain, self.renderer, self.generator = domain, renderer, generator
        self.size, self._next = max(pool, renderer.worlds), pool

    def draw(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The next batch, of the renderer's size."""
        count = self.renderer.worlds
        if self._next + count > self.size:
            self._states, self._next = sample_states(self.domain, self.size, self.generator), 0
        states = self._states[self._next:self._next + count]
        self._next += count
        frames = self.renderer.render(states, self.generator)
        images, pixels = augment(frames, self.generator)
        return (
            images,
            pixels,
            frames.visible,
            inside_image(pixels) & (frames.object_area >= LEAST_AREA)[:, None],
        )


def inside_image(pixels: Tensor) -> Tensor:
    """Whether (n, 8) pixels (n, 8, 2) lie inside the image."""
    limit = torch.tensor([CAMERA.width, CAMERA.height], device=pixels.device) - 0.5
    return ((pixels > -0.5) & (pixels < limit)).all(dim=-1)
