"""What a camera node needs of a camera, be it hardware or a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from np_description.calibration import Lens


class CameraError(OSError):
    """A camera that is not there, does not do what was requested, or has gone; the message names what to check."""


class EndOfImages(Exception):
    """A recording has been played to its end; the message names what was played."""


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """One image of a camera."""

    stamp: int
    """Time of the exposure on the host's clock, ns."""
    pixels: np.ndarray
    """RGB (height, width, 3) uint8."""


class CameraSource(Protocol):
    """A camera that has been opened. `lens`: of its images; `turn` (3, 3): from the camera's own optical
    frame to that of its images, where something upstream has turned them already; `period`: s between images;
    `values`: for diagnostics.
    """

    lens: Lens
    turn: np.ndarray
    period: float
    values: dict[str, object]

    def read(self, timeout: float) -> CameraFrame | None:
        """The next image, or None if none came within `timeout` s. Raises CameraError, EndOfImages."""

    def close(self) -> None:
        """Let go of the camera."""
