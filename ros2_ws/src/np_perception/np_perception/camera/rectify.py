"""From the camera's image to the one that the policies learned with: undistorted, turned, cropped and scaled
in one step.

A pinhole camera that turns about its centre shows the same rays elsewhere in the image. So a camera that looks a
few degrees past where it should is corrected exactly. One that stands elsewhere is not, and projections use its
true position (np_description.calibration).
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from np_description.calibration import Calibration, CalibrationError, Lens
from np_description.camera import CAMERA, Camera

VIEWS = ("policy", "calibration")
CALIBRATION_SIZE = 400  # px: the largest image that stays in shared memory; the same field of view as the policies'
_MAX_OUTSIDE = 0.0  # share of the view that may lie outside the camera's image


def view_camera(view: str, calibration: Calibration | None = None) -> Camera:
    """The camera whose images a view shows: "policy", or "calibration", which has more pixels in the same
    field of view."""
    camera = calibration.camera if calibration else CAMERA
    if view == "policy":
        return camera
    if view != "calibration":
        raise ValueError(f"view: expected one of {', '.join(VIEWS)}, got {view!r}")
    return _scale(camera, CALIBRATION_SIZE / camera.width)


def _scale(camera: Camera, factor: float) -> Camera:
    """The same view in `factor` times as many pixels; integer coordinates are centres of pixels."""
    return replace(
        camera,
        width=round(camera.width * factor),
        height=round(camera.height * factor),
        fx=camera.fx * factor,
        fy=camera.fy * factor,
        cx=(camera.cx + 0.5) * factor - 0.5,
        cy=(camera.cy + 0.5) * factor - 0.5,
    )


class Rectifier:
    """Turns images of a lens into those of `camera`; turn (3, 3): rotation from the lens's optical frame to
    the view's.

    Raises CalibrationError if part of the view lies outside the lens's image: there is nothing to show there.
    """

    def __init__(self, lens: Lens, camera: Camera = CAMERA, turn: np.ndarray | None = None) -> None:
        self.lens, self.camera = lens, camera
        self.turn = np.eye(3) if turn is None else np.asarray(turn, float)
        # Where many pixels become one they are averaged: sampled densely first, then scaled down by a whole
        # number.
        self._dense = max(1, int(np.ceil(lens.fx / camera.fx - 0.05)))
        dense = _scale(camera, self._dense)
        self._is_identity = lens == Lens(
            camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
        ) and np.allclose(self.turn, np.eye(3), rtol=0, atol=1e-12)
        u, v = np.meshgrid(np.arange(dense.width), np.arange(dense.height))
        pixels = self.source_pixels(np.stack([u, v], axis=-1).astype(float), dense)
        inside = (
            (pixels > -0.5).all(axis=-1) & (pixels[..., 0] < lens.width - 0.5) & (pixels[..., 1] < lens.height - 0.5)
        )
        if (outside := 1 - inside.mean()) > _MAX_OUTSIDE:
            degrees = np.degrees(np.arccos(np.clip((np.trace(self.turn) - 1) / 2, -1, 1)))
            raise CalibrationError(
                f"camera: expected an image that covers the whole view of the policies, {100 * outside:.1f} %"
                f" of it lie outside the camera's {lens.width} x {lens.height} image (f {lens.fx:.0f} px,"
                f" turned by {degrees:.1f} degrees): a larger image, or a camera that looks closer to where"
                " it should"
            )
        self._map = cv2.convertMaps(pixels[..., 0].astype(np.float32), pixels[..., 1].astype(np.float32), cv2.CV_16SC2)

    def source_pixels(self, pixels: np.ndarray, camera: Camera | None = None) -> np.ndarray:
        """Where the view's pixels (..., 2) lie in the lens's image."""
        camera = camera or self.camera
        rays = (
            np.concatenate(
                [
                    (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy),
                    np.ones((*pixels.shape[:-1], 1)),
                ],
                axis=-1,
            )
            @ self.turn
        )
        if (rays[..., 2] <= 0).any():
            raise CalibrationError(
                "camera: expected one that looks towards the view of the policies, it looks away from it"
            )
        return project_distorted(rays, self.lens)

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """The view (height, width, 3) of an image (lens.height, lens.width, 3) uint8. Raises ValueError for
        another shape."""
        if image.shape != (self.lens.height, self.lens.width, 3) or image.dtype != np.uint8:
            raise ValueError(
                f"image: expected ({self.lens.height}, {self.lens.width}, 3) uint8, got {image.shape} {image.dtype}"
            )
        if self._is_identity:
            return image
        view = cv2.remap(image, *self._map, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return (
            view
            if self._dense == 1
            else cv2.resize(view, (self.camera.width, self.camera.height), interpolation=cv2.INTER_AREA)
        )


def project_distorted(rays: np.ndarray, lens: Lens) -> np.ndarray:
    """Pixels (..., 2) of rays (..., 3) in the optical frame (Brown, 1971; OpenCV's and ROS's order of
    coefficients)."""
    x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
    k1, k2, p1, p2, k3 = lens.distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            lens.fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + lens.cx,
            lens.fy * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + lens.cy,
        ],
        axis=-1,
    )
