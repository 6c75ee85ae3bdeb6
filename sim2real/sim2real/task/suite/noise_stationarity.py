"""Do corners of an object at rest scatter by as much at one moment as at another? An exposure that hunts makes all of them noisier together."""

from __future__ import annotations

import warnings
from collections.abc import Iterable

import numpy as np
from scipy.ndimage import median_filter

from sim2real.task.keypoint_track import KeypointTrack
from sim2real.thresholds import THRESHOLDS

STATIC = THRESHOLDS.static_scene


def noise_variation_factor(track: KeypointTrack, stretches: Iterable[slice]) -> float:
    """By which factor (one standard deviation of its logarithm, as a factor) the scatter of all corners together goes up and down within stretches
    of images in which the object rests; 1 where no more than each corner's own does.

    A corner's own scatter has a memory, and goes up and down by chance. What corners have in common is measured by what is left of it when each is
    taken from another time.
    """
    pieces = [piece for one in stretches if (piece := _sizes(track, one)) is not None]
    if not pieces:
        return 1.0
    rng = np.random.default_rng(0)
    observed = _common(pieces)
    chance = [_common([_roll(piece, rng) for piece in pieces]) for _ in range(STATIC.draws)]
    if observed < STATIC.unlike * max(chance):
        return 1.0
    return float(np.exp(np.sqrt(max(observed - float(np.mean(chance)), 0.0))))


def _sizes(track: KeypointTrack, images: slice) -> np.ndarray | None:
    """Log px (n, c) of each corner's distance from where it is in the images about; None of a stretch that is too short."""
    steady = track.usable[images].mean(axis=0) > STATIC.shown
    if images.stop - images.start < 3 * STATIC.window or steady.sum() < STATIC.corners:
        return None
    pixels = track.pixels[images][:, steady]
    off = np.linalg.norm(pixels - median_filter(pixels, size=(STATIC.window, 1, 1), mode="nearest"), axis=-1)
    return np.log(np.where(off > 0, off, np.nan))


def _roll(sizes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    shifts = rng.integers(len(sizes), size=sizes.shape[1])
    return np.stack([np.roll(column, shift) for column, shift in zip(sizes.T, shifts)], axis=1)


def _common(pieces: list[np.ndarray]) -> float:
    """Variance, over windows of images, of the mean log size of all corners of a window; 0 where nothing scatters."""
    found = []
    for sizes in pieces:
        count = len(sizes) // STATIC.window
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a window that is empty
            windows = np.nanmedian(
                sizes[: count * STATIC.window].reshape(count, STATIC.window * sizes.shape[1]), axis=1
            )
        known = windows[np.isfinite(windows)]
        if len(known):  # none of a simulator's own corners, which do not scatter
            found.append(known - known.mean())
    return float(np.mean(np.square(np.concatenate(found)))) if found else 0.0
