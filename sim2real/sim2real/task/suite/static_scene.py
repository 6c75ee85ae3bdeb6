"""Does the object stay where it is seen while nothing touches it, and go no faster than what moves it? If not, the camera was moved, its lens
hunts, or the object is not left alone."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from np_description.camera import CAMERA, Camera
from sim2real.recordings.reading import ContractViolation
from sim2real.task.keypoint_noise import KeypointNoise, visible_noise_effects
from sim2real.task.suite.hand_proximity import HandTrajectory, hand_trajectory, interpolate_hidden
from sim2real.task.suite.noise_stationarity import noise_variation_factor
from sim2real.task.suite.recording import TaskRecording
from sim2real.thresholds import THRESHOLDS

STATIC = THRESHOLDS.static_scene
NOISE = {"keypoint_noise", "keypoint_outliers"}
"""What a detector's stage names that makes a picture that keeps still seem to move."""


@dataclass(frozen=True)
class StaticSceneCheck:
    """Whether the picture keeps still while nothing touches the object."""

    verdict: str
    """no_gap or unexplained."""
    moved: float
    """Largest displacement px of the picture while nothing touches the object, or largest step between images while the hand is slow."""
    at: float
    """Time s of the recording."""
    abstention_reason: str = ""
    """What was seen, where nothing explains it."""


def check_static_scene(
    recording: TaskRecording, camera: Camera = CAMERA, lift: float = 0.0, scatter: KeypointNoise | None = None
) -> StaticSceneCheck:
    """Of a recording of the task suite. camera, lift: as of `hand_proximity.hand_trajectory`; scatter: of its corners: what noise that is named makes of a picture
    that keeps still is no motion. Raises ContractViolation where the hand is at the object all the time."""
    own = hand_trajectory(recording, camera, lift)
    free = list(_untouched_spans(recording, own))
    displacements = [displacement for begin, end in free if (displacement := _displacement(recording, begin, end))]
    if not displacements:
        raise ContractViolation("the hand was at the object, or hid it, all the time")
    moved, at, _ = max(displacements)
    noise = float(np.median([noise for _, _, noise in displacements]))
    if moved > max(STATIC.moved, STATIC.surely * noise):
        reason = f"the picture moves by {moved:.1f} px at {at:.0f} s, while nothing touches the object"
        return StaticSceneCheck("unexplained", moved, at, reason)
    is_noisy = scatter is not None and bool(visible_noise_effects(scatter).keys() & NOISE)
    step, when, usual, by_chance = _largest_step(recording, own, is_noisy)
    if step > max(STATIC.step, STATIC.surely * usual, by_chance):
        reason = f"the picture jumps by {step:.1f} px at {when:.0f} s, faster than the hand moves the object"
        return StaticSceneCheck("unexplained", step, when, reason)
    factor = noise_variation_factor(recording.track, [_images(recording, begin, end) for begin, end in free])
    if factor > STATIC.uneven:
        reason = f"corners of an object at rest scatter by {factor:.1f} times more or less from moment to moment: light or exposure changes"
        return StaticSceneCheck("unexplained", moved, at, reason)
    return StaticSceneCheck("no_gap", moved, at)


def _shuffle(values: np.ndarray) -> Iterator[np.ndarray]:
    """Draws of what corners (n, c, 2) do each for itself, every corner at another time: all of its noise, and no motion of all of them."""
    rng = np.random.default_rng(0)
    own = values - np.nanmedian(values, axis=1, keepdims=True)
    for _ in range(STATIC.draws):
        shifts = rng.integers(len(own), size=own.shape[1])
        yield np.stack([np.roll(own[:, k], shift, axis=0) for k, shift in enumerate(shifts)], axis=1)


def _untouched_spans(recording: TaskRecording, own: HandTrajectory) -> Iterator[tuple[float, float]]:
    """(begin, end) s between which the hand is not at the object."""
    begin = recording.seen_from
    for first, last in [*own.touching, (float(recording.log.time[-1]), np.inf)]:
        if first - begin > STATIC.least:
            yield begin, first
        begin = max(begin, last)


def _images(recording: TaskRecording, begin: float, end: float) -> slice:
    """Images between two moments, s of the log."""
    return slice(*np.searchsorted(recording.track.time + recording.seen_from, [begin, end]).tolist())


def _displacement(recording: TaskRecording, begin: float, end: float) -> tuple[float, float, float] | None:
    """px by which the corners together go from their middle place in a stretch, by medians over some images; s at which they are farthest; px
    of noise of such a way, by what corners do each for itself. None where too little is seen."""
    track, images = recording.track, _images(recording, begin, end)
    taken = track.time + recording.seen_from
    steady = track.usable[images].mean(axis=0) > STATIC.shown
    if images.stop - images.start < 3 * STATIC.window or steady.sum() < STATIC.corners:
        return None
    half = STATIC.window // 2  # at either end, where a filter has fewer images to take a median of
    shown = [
        interpolate_hidden(taken[images], track.pixels[images, c], track.usable[images, c])
        for c in np.flatnonzero(steady)
    ]
    smooth = median_filter(np.stack(shown, axis=1), size=(STATIC.window, 1, 1))[half:-half]
    off = smooth - np.median(smooth, axis=0)
    together = np.median(off, axis=1)
    noise = np.sqrt(np.pi / 2 * np.mean((off - together[:, None]) ** 2) / steady.sum())  # of a median
    distance = np.linalg.norm(together, axis=1)
    return float(distance.max()), float(taken[images.start + half + distance.argmax()]), float(noise)


def _largest_step(recording: TaskRecording, own: HandTrajectory, is_noisy: bool) -> tuple[float, float, float, float]:
    """px by which the corners together go farther from one image to the next, and stay, than in those about them, at most, where the hand is
    slow; s at which; px by which they usually do, and, where noise is named, the most that it makes of one.

    Corners that are found wrongly in one image are back in the next: what lasts is in the step from the image before the last, too, and in
    the one to the image after the next.
    """
    track = recording.track
    taken = track.time + recording.seen_from
    slow = np.ones(len(taken), bool)
    for begin, end in own.quick:
        slow &= (taken < begin) | (taken > end)
    pixels = np.where(track.usable[..., None], track.pixels, np.nan)
    before, last, now, after = pixels[:-3], pixels[1:-2], pixels[2:-1], pixels[3:]
    steps = np.concatenate([now - last, now - before, after - last], axis=-1)
    known = np.isfinite(steps).all(axis=-1).sum(axis=1) >= STATIC.corners
    near = slow & np.r_[True, np.diff(taken) < THRESHOLDS.keypoint_track.gap * track.period]
    known &= slow[:-3] & near[1:-2] & near[2:-1] & near[3:]
    if known.sum() < STATIC.window:
        return 0.0, 0.0, 0.0, 0.0
    excess = _excess(steps[known])
    most = max(_excess(one).max() for one in _shuffle(steps[known])) if is_noisy else 0.0
    usual = 1.4826 * np.median(np.abs(excess))
    return float(excess.max()), float(taken[2:-1][known][excess.argmax()]), float(usual), STATIC.beyond * float(most)


def _excess(steps: np.ndarray) -> np.ndarray:
    """px (n,) by which corners together go farther in steps (n, c, 6), the least of three, than in the images about."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # shuffled, an image may have no corner
        together = np.nan_to_num(np.nanmedian(steps, axis=1)).reshape(-1, 3, 2)
    size = np.linalg.norm(together, axis=-1).min(axis=-1)
    return size - median_filter(size, size=STATIC.window, mode="nearest")
