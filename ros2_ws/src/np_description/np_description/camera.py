"""The camera: one pinhole model for rendering, labels, policies and calibration.

Optical frame as in ROS and OpenCV: x right, y down, z forward. Pixel (0, 0) is the centre of the top-left pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_common.rotations import namespace


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics of a pinhole camera."""

    width: int
    """px."""
    height: int
    """px."""
    fx: float
    """Focal length along u, px."""
    fy: float
    """Focal length along v, px."""
    cx: float
    """Principal point, u px."""
    cy: float
    """Principal point, v px."""

    @property
    def matrix(self) -> np.ndarray:
        """Intrinsic matrix K (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])


@dataclass(frozen=True)
class Camera(Pinhole):
    """An ideal pinhole camera fixed in the base frame."""

    position: tuple[float, float, float]
    """Of the optical frame (3,) m."""
    rotation: tuple[tuple[float, float, float], ...]
    """Optical frame to base frame (3, 3)."""

    @property
    def fovy(self) -> float:
        """Vertical field of view in degrees (MuJoCo's convention; exact for a centred principal point)."""
        return float(np.degrees(2 * np.arctan(self.height / (2 * self.fy))))

    def project(self, points):
        """Pixels (..., 2) and depths (...) m of points (..., 3) m in the base frame; depth <= 0 is behind the lens."""
        xp = namespace(points)
        rotation, position = np.asarray(self.rotation), np.asarray(self.position)
        if xp is not np:
            rotation = xp.as_tensor(rotation, dtype=points.dtype, device=points.device)
            position = xp.as_tensor(position, dtype=points.dtype, device=points.device)
        optical = ((points - position)[..., :, None] * rotation).sum(axis=-2)
        depth = optical[..., 2]
        u = self.fx * optical[..., 0] / depth + self.cx
        v = self.fy * optical[..., 1] / depth + self.cy
        return xp.stack([u, v], axis=-1), depth

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Directions (n, 3) in the base frame, 1 long along the optical axis, in which pixels (n, 2) look."""
        optical = np.column_stack([(pixels - (self.cx, self.cy)) / (self.fx, self.fy), np.ones(len(pixels))])
        return optical @ np.asarray(self.rotation).T

    def at_height(self, rays: np.ndarray, height: float | np.ndarray) -> np.ndarray:
        """Points (n, 2) m of the base frame at which `rays` (n, 3) come to a height m, or to one each (n,)."""
        eye = np.asarray(self.position)
        return eye[:2] + rays[:, :2] * ((height - eye[2]) / rays[:, 2])[:, None]

    def normalise(self, pixels):
        """Image coordinates (..., 2) in [-1, 1] across the image, the unit in which policies see keypoints."""
        xp = namespace(pixels)
        return xp.stack(
            [(pixels[..., 0] + 0.5) * (2 / self.width) - 1, (pixels[..., 1] + 0.5) * (2 / self.height) - 1], axis=-1
        )


def look_at(position, target) -> tuple[tuple[float, float, float], ...]:
    """Rotation optical -> base of a camera at `position` that looks at `target`, image upright."""
    forward = np.asarray(target, float) - np.asarray(position, float)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    return tuple(map(tuple, np.stack([right, down, forward], axis=1).tolist()))


_POSITION = (1.10, 0.0, 0.68)
CAMERA = Camera(
    # The colour stream of a RealSense D435 at 1280 x 720 has f of about 920 px (datasheet: 69 x 42 degrees). A centred crop
    # of 496 px, scaled to 224, shows the workspace at about 2 mm a pixel.
    width=224,
    height=224,
    fx=415.0,
    fy=415.0,
    cx=111.5,
    cy=111.5,
    position=_POSITION,
    rotation=look_at(_POSITION, (0.50, 0.0, 0.0)),
)
