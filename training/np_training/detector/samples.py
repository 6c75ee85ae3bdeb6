"""Endless labelled training images."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, fields
from typing import NamedTuple

import torch
from torch import Tensor

from np_description.camera import CAMERA
from np_description.domains import Task
from np_training.detector.augment import Augmentation, augment
from np_training.detector.render import Frames, SceneRenderer
from np_training.detector.scenes import sample_states, tumble_objects
from np_training.detector.visited import mix_visited

KEPT = 16  # batches of renderings, where each is used more than once
LEAST_AREA = 12.0  # px of the object: below it the corners cannot be located


@dataclass(frozen=True)
class SampleConfig:
    """visited: share of the states that come from recorded episodes, where there are any; turned: share in which the object lies on any
    face, of domains with obstacles; reuse: batches from a rendering, each
    augmented anew (on a CPU, rendering is the slow part)."""

    visited: float = 0.6
    turned: float = 0.2
    reuse: int = 1
    augmentation: Augmentation = Augmentation()


class LabelledImages(NamedTuple):
    """images (n, 3, 224, 224); pixels (n, 8, 2) of the corners; visible, present (n, 8) bool; second: the same
    renderings augmented anew, or None.

    A corner is present if it lies inside an image that shows something of the object: hidden ones are to be
    inferred.
    """

    images: Tensor
    pixels: Tensor
    visible: Tensor
    present: Tensor
    second: Tensor | None = None


class ImageGenerator:
    """Endless labelled images of a domain; visited: states (m, 16) of recorded episodes; pairs: whether every
    rendering is augmented twice."""

    def __init__(
        self,
        domain: Task,
        renderer: SceneRenderer,
        pool: int,
        generator: torch.Generator,
        config: SampleConfig = SampleConfig(),
        visited: Tensor | None = None,
        pairs: bool = False,
    ) -> None:
        self.domain, self.renderer, self.generator = domain, renderer, generator
        self.config, self.visited, self.pairs = config, visited, pairs
        self.size, self._next = max(pool, renderer.worlds), pool
        self._kept: deque[Frames] = deque(maxlen=KEPT)
        self._drawn = 0

    def draw(self) -> LabelledImages:
        """The next batch, of the renderer's size."""
        frames = self._frames()
        images, pixels = augment(frames, self.generator, self.config.augmentation)
        second = augment(frames, self.generator, self.config.augmentation)[0] if self.pairs else None
        present = inside_image(pixels) & (frames.object_area >= LEAST_AREA)[:, None]
        return LabelledImages(images, pixels, frames.visible, present, second)

    def _frames(self) -> Frames:
        """New renderings, or some of those that are kept."""
        if self.config.reuse == 1:
            return self._render()
        if self._drawn % self.config.reuse == 0:
            frames = self._render()
            self._kept.append(Frames(*(getattr(frames, field.name).clone() for field in fields(frames))))
        self._drawn += 1
        index = torch.randint(len(self._kept), (1,), generator=self.generator, device=self.generator.device)
        return self._kept[int(index)]

    def _render(self) -> Frames:
        count = self.renderer.worlds
        if self._next + count > self.size:
            self._states, self._next = self._draw_states(), 0
        states = self._states[self._next : self._next + count]
        self._next += count
        return self.renderer.render(states, self.generator)

    def _draw_states(self) -> Tensor:
        states = sample_states(self.domain, self.size, self.generator)
        if self.visited is not None:
            states = mix_visited(states, self.visited, self.config.visited, self.generator)
        if self.domain.obstacles:
            states = tumble_objects(self.domain, states, self.config.turned, self.generator)
        return states


def inside_image(pixels: Tensor) -> Tensor:
    """Whether (n, 8) pixels (n, 8, 2) lie inside the image."""
    limit = torch.tensor([CAMERA.width, CAMERA.height], device=pixels.device) - 0.5
    return ((pixels > -0.5) & (pixels < limit)).all(dim=-1)
