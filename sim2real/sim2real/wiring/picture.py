"""Conventions of image and keypoints: corners of a box that rests on the table, as the nominal camera shows them.

A picture that is rotated or mirrored, or corners in another order, make of them a shape that no box at rest has.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from np_description.camera import CAMERA
from np_description.domains import Task
from np_description.keypoints import CORNERS
from sim2real.task.camera.flat_pose import fit_flat_pose
from sim2real.task.camera.rest_poses import RestPose
from sim2real.thresholds import THRESHOLDS
from sim2real.wiring.fault import WiringFault

WIRING, SCORE = THRESHOLDS.wiring, THRESHOLDS.keypoint_track.score
PICTURES = {
    "rotated by 90 degrees": (1, False),
    "rotated by 180 degrees": (2, False),
    "rotated by 270 degrees": (3, False),
    "mirrored from left to right": (0, True),
    "mirrored from top to bottom": (2, True),
    "mirrored at a diagonal": (1, True),
    "mirrored at the other diagonal": (3, True),
}
"""Quarter turns counterclockwise of a picture (`np.rot90`) after it is mirrored from left to right, or not."""
STEP, MOVED = 2, 0.006  # images on either side; m by which an object is seen to move between them
RING = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
"""Corners of a face one after the other, as OpenCV and CAD programs number them."""


def find_keypoint_fault(keypoints: np.ndarray, domain: Task, tip: np.ndarray | None = None) -> WiringFault | None:
    """Of keypoints (n, 8, 3) u px, v px, score of images of the domain's object. tip (n, 3) m: the tool point while they were taken."""
    if len(keypoints) < WIRING.least_images:
        return None
    seldom = slice(None, None, -(-len(keypoints) // WIRING.images))

    def misfit(changed: np.ndarray) -> float:
        shape = _misfit(changed[seldom], domain) / WIRING.corner_error
        return max(shape, _hand_distance(changed, domain, tip) / WIRING.hand_distance)

    before = misfit(keypoints)
    if before * WIRING.corner_error <= WIRING.least_corner_error:
        return None
    found = [(misfit(undo(keypoints)), fault) for undo, fault in _candidates()]
    nearest, fault = min(found, key=lambda pair: pair[0])
    return fault if nearest < min(1.0, before / WIRING.clearly) else None


def find_image_fault(images: np.ndarray, domain: Task) -> WiringFault | None:
    """Of images (n, height, width, 3) as they were recorded for RGB: by what the released detector finds in them, and in them changed.

    Raises WeightsError where the domain has no detector.
    """
    from np_perception.detector import KeypointDetector  # slow, and needs onnxruntime

    detector = KeypointDetector(domain)
    images = images[:: -(-len(images) // WIRING.detected)]

    def quality(change: Callable[[np.ndarray], np.ndarray]) -> tuple[float, float]:
        """(misfit px, mean score) of changed images."""
        found = np.array([detector.detect(np.ascontiguousarray(change(image))).keypoints for image in images])
        return _misfit(found, domain), float(found[:, :, 2].mean())

    off, score = quality(lambda image: image)
    if off <= WIRING.least_corner_error:
        return None
    changes = {"colours": lambda image: image[..., ::-1]}
    changes |= {name: _undo_picture(*how) for name, how in PICTURES.items()}
    found = {name: quality(change) for name, change in changes.items()}
    possible = [name for name in found if found[name][1] > score - WIRING.score]
    name = min(possible, key=lambda name: found[name][0], default="")
    if not name or found[name][0] >= min(WIRING.corner_error, off / WIRING.clearly):
        return None
    return _colour_fault() if name == "colours" else _picture_fault("camera/image_raw", name)


def _misfit(keypoints: np.ndarray, domain: Task) -> float:
    """Median over images of the error px of corners, of the pose at rest that explains them best."""
    off = []
    for image in keypoints:
        error = np.where(image[:, 2] >= SCORE, 1.0, np.inf)
        if np.isfinite(error).sum() >= WIRING.corners:
            off.append(fit_flat_pose(RestPose("", image[:, :2], error, domain), CAMERA).off)
    return float(np.median(off)) if len(off) > len(keypoints) / 4 else np.inf


def _hand_distance(keypoints: np.ndarray, domain: Task, tip: np.ndarray | None) -> float:
    """Median distance m, along the table, of the tool point from an object that moves, beyond the object's reach; 0 where it does not move."""
    if tip is None:
        return 0.0
    usable = np.where(keypoints[:, :, 2:] >= SCORE, keypoints[:, :, :2], np.nan)
    known = np.isfinite(usable[..., 0]).sum(axis=1) >= WIRING.corners
    rays = CAMERA.rays(np.nanmedian(usable[known], axis=1)) if known.any() else np.zeros((0, 3))
    if len(rays) < 2 * STEP + 1 or not (rays[:, 2] < 0).all():
        return 0.0 if not len(rays) else np.inf
    half = np.asarray(domain.half_size)
    centre = CAMERA.at_height(rays, float(half.min()))
    moves = np.linalg.norm(centre[2 * STEP :] - centre[: -2 * STEP], axis=1) > MOVED
    if moves.sum() < WIRING.least_images:
        return 0.0
    away = np.linalg.norm(tip[known][STEP:-STEP, :2] - centre[STEP:-STEP], axis=1)[moves]
    return max(0.0, float(np.median(away)) - float(np.hypot(*np.sort(half)[1:])))


def _candidates() -> Iterator[tuple[Callable[[np.ndarray], np.ndarray], WiringFault]]:
    """What undoes a wrong convention of keypoints (n, 8, 3), and the fault."""
    for name, (turns, is_mirrored) in PICTURES.items():
        yield lambda k, t=turns, m=is_mirrored: _undo_pixels(k, t, m), _picture_fault("keypoints", name)
    for text, order in corner_orders().items():
        position = np.argsort(order)
        yield (
            lambda k, p=position: k[:, p],
            WiringFault(
                "corners",
                "keypoints",
                f"Corners are numbered {text}, not by 4 [x > 0] + 2 [y > 0] + [z > 0].",
                f"Publish the corners that have the numbers {', '.join(map(str, position.tolist()))} now as 0 to 7.",
            ),
        )


def corner_orders() -> dict[str, np.ndarray]:
    """By its description, a usual order of corners: number (8,) in the contract's order of each."""

    def numbers(signs: np.ndarray) -> np.ndarray:
        return (signs > 0) @ np.array([4, 2, 1])

    orders = {}
    for axes, name in (
        ((2, 1, 0), "x fastest"),
        ((0, 2, 1), "y fastest, x slowest"),
        ((1, 0, 2), "z fastest, y slowest"),
    ):
        orders[f"with {name}"] = numbers(CORNERS[:, np.argsort(axes)])
    orders["with x fastest, y slowest"] = numbers(CORNERS[:, [2, 0, 1]])
    orders["with y fastest, z slowest"] = numbers(CORNERS[:, [1, 2, 0]])
    for first, name in ((-1, "bottom"), (1, "top")):
        for step, way in ((1, "counterclockwise"), (-1, "clockwise")):
            ring = np.roll(RING[::step], 1, axis=0) if step < 0 else RING
            signs = np.array([[*xy, z] for z in (first, -first) for xy in ring])
            orders[f"{way} about the {name} face, then the other"] = numbers(signs)
    orders["in reverse"] = np.arange(8)[::-1]
    return orders


def _undo_pixels(keypoints: np.ndarray, turns: int, is_mirrored: bool) -> np.ndarray:
    """Keypoints of the picture before it was mirrored and turned; it is square."""
    u, v, score = np.moveaxis(keypoints, -1, 0)
    last = CAMERA.width - 1
    for _ in range(turns):  # a pixel that is at (u, v) now was at (last - v, u) a quarter turn ago
        u, v = last - v, u
    return np.stack([last - u if is_mirrored else u, v, score], axis=-1)


def _undo_picture(turns: int, is_mirrored: bool) -> Callable[[np.ndarray], np.ndarray]:
    """An image before it was mirrored and turned."""
    return lambda image: np.rot90(image, -turns)[:, ::-1] if is_mirrored else np.rot90(image, -turns)


def _picture_fault(stream: str, name: str) -> WiringFault:
    note = ", or the corners of the object are numbered with one axis reversed" if "mirrored" in name else ""
    return WiringFault(
        "image",
        stream,
        f"The picture is {name}{note}.",
        f"Undo it in the camera's driver: a picture that is {name} by it is upright.",
    )


def _colour_fault() -> WiringFault:
    return WiringFault(
        "colours",
        "camera/image_raw",
        "Red and blue of the image are exchanged: its bytes are BGR, its encoding is rgb8.",
        "Convert the image to RGB before it is published, or publish it as bgr8.",
    )
