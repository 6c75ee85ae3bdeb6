"""One record an effect of the view: what a patch may say of it, and what it changes between the scene and the keypoints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from np_description.camera import Camera
from sim2real.effects.catalogue import catalogue
from sim2real.effects.record import Quantity


class Part(StrEnum):
    """What an effect of the view belongs to: the camera with its clock, or what finds the keypoints in its images."""

    CAMERA = "camera"
    KEYPOINTS = "keypoints"


@dataclass(frozen=True)
class Seen:
    """The declared magnitude from which on the task suite can show an effect at all: size 1 of the blind test. largest:
    multiple of it up to which the size is physical."""

    unit: str
    limit: float
    largest: float = 8.0


Given = Mapping[str, float]
"""What a patch gives for an effect, every quantity by name."""


@dataclass(frozen=True)
class Disturbance:
    """What is random about keypoints, once an image.

    given: the quantities; rng: of this image alone, so that the same recording has the same draws; last (8, 2) px: the
    disturbance of the image before. In training all of it is of many images: what is drawn and `last` are tensors (n, ...).
    """

    given: Given
    rng: np.random.Generator
    last: np.ndarray


class Catalogued:
    """An effect `id` with a row of the catalogue."""

    id: str

    @property
    def module(self) -> str:
        """Where reports say that it sits."""
        return self.entry["module"]

    @property
    def entry(self) -> Mapping[str, str]:
        """Its row of the catalogue. Raises KeyError where there is none."""
        return catalogue()[self.id]


@dataclass(frozen=True, eq=False)
class ViewRecord(Catalogued):
    """An effect of the view.

    pose: what the true camera is, given the one that is believed. age: s by which the scene in an image is older than the
    image's stamp (s). rows: s that pass from the first row of an image to the last, its stamp being that of the middle. exposure:
    s over which an image is collected, up to its moment. lens: pixels (..., 2) that a lens makes of those of the ideal one.
    repeats: share of the images that show the one before again. move: px (8, 2) by which keypoints are off in an image; kept: whether
    that is handed on as `Disturbance.last`.
    """

    id: str
    part: Part
    quantities: tuple[Quantity, ...]
    seen: Seen
    said: str
    pose: Callable[[Camera, Given], Camera] | None = None
    age: Callable[[Given, float], float] | None = None
    rows: Callable[[Given], float] | None = None
    exposure: Callable[[Given], float] | None = None
    lens: Callable[[np.ndarray, Camera, Given], np.ndarray] | None = None
    repeats: Callable[[Given], float] | None = None
    move: Callable[[Disturbance], np.ndarray] | None = None
    kept: bool = False

    @property
    def carriers(self) -> tuple[str, ...]:
        """Who carries it: images, those of a simulated camera; keypoints, those of `keypoint_oracle`; training, which draws none of what
        happens within an image, or to whole images."""
        images = ("images",) if any((self.pose, self.age, self.lens, self.repeats)) else ()
        learned = ("training",) if any((self.pose, self.age, self.lens, self.move)) else ()
        return (*images, "keypoints", *learned)
