"""The view of a simulated camera with effects: the moment shown, and the lens."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import cv2
import numpy as np
from sim2real.effects.camera_effects import CameraEffects

from np_sim_bridge.schedule import PERIOD, SECOND

ROUNDS = 20  # in which the pixel is found that a lens puts somewhere
Moment = tuple[int, np.ndarray]
"""Stamp ns and the scene's generalised positions (nq,)."""


class SceneView:
    """The scene's latest configurations, and the pictures of them."""

    def __init__(self, effects: CameraEffects):
        self._effects = effects
        self._needs_past = effects.oldest > 0 or effects.repeats
        self._past: deque[Moment] = deque(maxlen=2 + int(np.ceil(effects.oldest * SECOND / PERIOD)))
        self._shown: Moment | None = None
        self._map = _inverse_map(effects) if effects.has_lens else None

    def begin(self) -> None:
        """Forget what was: the scene has been set up anew."""
        self._past.clear()
        self._shown = None

    def keep(self, stamp: int, configuration: Callable[[], np.ndarray]) -> None:
        """Remember the scene (nq,) of `stamp` ns, where an image may show it later."""
        if self._needs_past:
            self._past.append((stamp, configuration()))

    def scene(self, stamp: int, configuration: Callable[[], np.ndarray]) -> np.ndarray:
        """The scene (nq,) that the image of `stamp` ns shows: that of now, of a moment before, or the earliest that is known."""
        if not self._needs_past:
            return configuration()
        moment = round(self._effects.moment(stamp) * SECOND)
        if self._shown is None or self._shown[0] != moment:
            found = next((scene for when, scene in reversed(self._past) if when <= moment), self._past[0][1])
            self._shown = moment, found
        return self._shown[1]

    def through_lens(self, pixels: np.ndarray) -> np.ndarray:
        """The image (height, width, 3) uint8 that the true lens makes of that of the ideal one; its border goes on outside."""
        if self._map is None:
            return pixels
        return cv2.remap(pixels, self._map, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _inverse_map(effects: CameraEffects) -> np.ndarray:
    """Pixels (height, width, 2) of the ideal image that the true one shows at each of its own."""
    camera = effects.believed
    shown = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).astype(float)
    source = shown.copy()
    for _ in range(ROUNDS):  # a lens moves pixels little, and neighbours alike
        source += shown - effects.lens(source)
    return source.astype(np.float32)
