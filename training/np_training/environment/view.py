"""The view of a patch in every world at once: sim2real.effects.camera_effects for tensors, and images that are late.

Camera, lens and age are the records' own. What is random about keypoints comes from the same hooks too, an image at a time, with tensors in
place of NumPy's arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from sim2real.effects.effect import Disturbance
from sim2real.effects.patch import Patch

from np_description.camera import CAMERA
from np_description.keypoints import COUNT

IMAGES = 3  # in a policy period, at the camera's 30 Hz


@dataclass(frozen=True)
class _Draws:
    """What a effect draws from, for `worlds` images side by side."""

    worlds: int
    device: torch.device

    def standard_normal(self, shape: tuple[int, ...]) -> torch.Tensor:
        return torch.randn(self.worlds, *shape, device=self.device)

    def random(self, size: int) -> torch.Tensor:
        return torch.rand(self.worlds, size, device=self.device)


class BatchedView:
    """Where the corners of objects are found by a camera whose nominal model is CAMERA. age: s by which images are late."""

    def __init__(self, patch: Patch = Patch()) -> None:
        self._effects = [(e.definition, e.values) for e in patch.camera.effects]
        self.camera = CAMERA
        for effect, given in self._effects:
            if effect.camera_pose:
                self.camera = effect.camera_pose(self.camera, given)
        self.age = max(0.0, sum(effect.image_age(given, 0.0) for effect, given in self._effects if effect.image_age))
        self._left: dict[str, torch.Tensor] = {}

    def keypoints(self, points: torch.Tensor, is_first: bool = False) -> torch.Tensor:
        """Normalised image coordinates (n, 8, 2) of corners (n, 8, 3) m in the base frame; is_first: of images that none was before."""
        pixels = self.camera.project(points)[0]
        for effect, given in self._effects:
            if effect.lens:
                pixels = effect.lens(pixels, CAMERA, given)
        draws, nothing = _Draws(len(points), points.device), torch.zeros_like(pixels)
        for effect, given in self._effects:
            if not effect.move_keypoints:
                continue
            last = self._left.get(effect.id) if effect.has_memory and not is_first else None
            for _ in range(1 if last is None else IMAGES):
                last = effect.move_keypoints(Disturbance(given, draws, nothing if last is None else last))
            moved = torch.as_tensor(last, dtype=pixels.dtype, device=pixels.device)
            pixels = pixels + moved
            if effect.has_memory and not is_first:
                self._left[effect.id] = moved
        return CAMERA.normalise(pixels)


class Past:
    """Corners (worlds, 8, 3) m of some policy periods ago, newest first; `longest` periods back at most."""

    def __init__(self, worlds: int, longest: float, device: torch.device) -> None:
        self._corners = torch.zeros(1 + int(longest), worlds, COUNT, 3, device=device)

    def remember(self, points: torch.Tensor) -> None:
        """A period begins with corners (worlds, 8, 3) m."""
        self._corners = torch.cat([points[None], self._corners[:-1]])

    def begin(self, points: torch.Tensor, where: torch.Tensor) -> None:
        """In the worlds `where` (n,) they have been where they are now, of points (worlds, 8, 3) m, all the time."""
        self._corners[:, where] = points[where]

    def at(self, now: torch.Tensor, age: torch.Tensor) -> torch.Tensor:
        """Corners (worlds, 8, 3) m `age` (worlds, 1, 1) periods before they are `now`: in proportion between two periods."""
        known = torch.cat([now[None], self._corners])
        newer = age.floor().clamp(0, len(self._corners) - 1)
        share = (age - newer).clamp(0, 1)
        rows = newer.long()[:, 0, 0]
        worlds = torch.arange(len(now), device=now.device)
        return known[rows, worlds] + share * (known[rows + 1, worlds] - known[rows, worlds])
