"""What a patch does between the scene and the keypoints: the hooks of its records, composed in the order of nature.

The scene at the moments that an image is of; the camera where it truly is; the lens; then what is wrong with finding corners.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.keypoints import COUNT
from sim2real.effects.effect import Disturbance
from sim2real.effects.patch import Patch

NS = 1e-9  # s
MOMENTS = 5  # of an exposure, whose images are averaged
ROUNDS = 3  # in which the moment of a corner's row is found: what moves is in another row at another moment
CornersAt = Callable[[np.ndarray], np.ndarray]
"""Corners (n, 8, 3) m in the base frame at times (n,) s."""


class CameraEffects:
    """The view of a simulated camera whose nominal model is `camera`.

    seed: of what is random; with an image's stamp it determines the draw. Request images in the order of their stamps. The
    newest may be requested again; an earlier one begins a new recording.
    """

    def __init__(self, patch: Patch, camera: Camera = CAMERA, seed: int = 0):
        self._effects = [(e.definition, e.values) for e in patch.camera.effects]
        self._seed = seed
        self.believed = self.camera = camera
        for effect, values in self._effects:
            if effect.camera_pose:
                self.camera = effect.camera_pose(self.camera, values)
        self._rows = sum(effect.readout_time(values) for effect, values in self._effects if effect.readout_time)
        self._exposure = sum(effect.exposure(values) for effect, values in self._effects if effect.exposure)
        self._begin()

    def _begin(self) -> None:
        self._newest = -1  # ns, stamp of the newest image
        self._shown = 0.0  # s, its moment
        self._found: tuple[int, np.ndarray] = -1, np.zeros((COUNT, 2))  # stamp ns and pixels of the newest keypoints
        self._drawn: tuple[float, np.ndarray] | None = (
            None  # moment s of the newest image, and where the corners are in it
        )
        self._left = {effect.id: np.zeros((COUNT, 2)) for effect, _ in self._effects if effect.has_memory}

    @property
    def has_lens(self) -> bool:
        """Whether any effect changes where in an image something is drawn."""
        return any(effect.lens for effect, _ in self._effects)

    @property
    def repeats(self) -> bool:
        """Whether an image may show the one before again."""
        return any(effect.repeats for effect, _ in self._effects)

    @property
    def only_in_keypoints(self) -> tuple[str, ...]:
        """Effects of the patch that images do not carry."""
        return tuple(effect.id for effect, _ in self._effects if "images" not in effect.supported_in)

    @property
    def oldest(self) -> float:
        """s by which a scene may be older than the stamp of its image, in recordings of less than an hour."""
        ages = (
            max(effect.image_age(values, s) for s in (0.0, 3600.0))
            for effect, values in self._effects
            if effect.image_age
        )
        return max(0.0, sum(ages)) + self._exposure + self._rows / 2

    def moment(self, stamp: int) -> float:
        """s at which the scene was as the image of `stamp` ns shows it.

        Never after the stamp: what is still to come no simulator can show. An image that is repeated is of the moment of the one before.
        """
        if stamp < self._newest:
            self._begin()
        if stamp != self._newest:
            now = stamp * NS
            shares = [effect.repeats(values) for effect, values in self._effects if effect.repeats]
            if self._newest < 0 or all(self._rng("frame", stamp).random() >= share for share in shares):
                age = sum(effect.image_age(values, now) for effect, values in self._effects if effect.image_age)
                self._shown = now - max(age, 0.0)
            self._newest = stamp
        return self._shown

    def lens(self, pixels: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) at which the true lens has what an ideal one has at `pixels`."""
        for effect, values in self._effects:
            if effect.lens:
                pixels = effect.lens(pixels, self.believed, values)
        return pixels

    def keypoints(self, corners_at: CornersAt, stamp: int) -> np.ndarray:
        """Where the corners are found, px (8, 2), in the image of `stamp` ns."""
        moment = self.moment(stamp)
        if stamp == self._found[0]:
            return self._found[1]
        if self._drawn is None or self._drawn[0] != moment:
            self._drawn = moment, self._draw(corners_at, moment)
        self._found = stamp, self._drawn[1] + self._disturb(stamp)
        return self._found[1]

    def _draw(self, corners_at: CornersAt, moment: float) -> np.ndarray:
        """Where the corners are in the image of a moment, px (8, 2)."""
        middle = (self.believed.height - 1) / 2
        rows = np.full(COUNT, middle)
        for _ in range(ROUNDS if self._rows else 1):
            starts = moment + self._rows * (rows - middle) / self.believed.height
            pixels = np.mean([self._project(corners_at, starts - late) for late in self._lateness()], axis=0)
            rows = pixels[:, 1]
        return pixels

    def _lateness(self) -> np.ndarray:
        """s before its moment, of which an image is the mean."""
        return self._exposure * (np.arange(MOMENTS) + 0.5) / MOMENTS if self._exposure else np.zeros(1)

    def _project(self, corners_at: CornersAt, times: np.ndarray) -> np.ndarray:
        """Pixels (8, 2) of the corners, each at its own time (8,) s."""
        corners = corners_at(times)[np.arange(COUNT), np.arange(COUNT)]
        return self.lens(self.camera.project(corners)[0])

    def _disturb(self, stamp: int) -> np.ndarray:
        total = np.zeros((COUNT, 2))
        for effect, values in self._effects:
            if effect.move_keypoints:
                last = self._left.get(effect.id, np.zeros((COUNT, 2)))
                moved = effect.move_keypoints(Disturbance(values, self._rng(effect.id, stamp), last))
                if effect.has_memory:
                    self._left[effect.id] = moved
                total += moved
        return total

    def _rng(self, name: str, stamp: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, stamp, *name.encode()])
