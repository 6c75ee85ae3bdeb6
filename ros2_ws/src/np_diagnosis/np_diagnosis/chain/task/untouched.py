"""Does the object stay where it is seen while nothing touches it, and go no faster than what moves it? If not, the camera was moved, its lens
hunts, or the object is not left alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from np_description.camera import CAMERA, Camera
from np_diagnosis.chain.task.near import Hand, hand
from np_diagnosis.chain.task.recording import TaskRecording
from np_diagnosis.recordings.reading import ContractViolation
from np_diagnosis.thresholds import THRESHOLDS

UNTOUCHED = THRESHOLDS.untouched


@dataclass(frozen=True)
class Untouched:
    """verdict: no_gap or unexplained; moved: px, the largest way of the picture while nothing touched the object, or the largest step from one
    image to the next where the hand is slow; at: s of the recording; doubt: what was seen, where nothing explains it."""

    verdict: str
    moved: float
    at: float
    doubt: str = ""


def untouched(recording: TaskRecording, camera: Camera = CAMERA, lift: float = 0.0) -> Untouched:
    """Of a recording of the task suite. camera, lift: as of `near.hand`. Raises ContractViolation where the hand is at the object all the time."""
    own = hand(recording, camera, lift)
    ways = [way for begin, end in _between(recording, own) if (way := _way(recording, begin, end))]
    if not ways:
        raise ContractViolation("the hand was at the object, or hid it, all the time")
    moved, at, _ = max(ways)
    noise = float(np.median([noise for _, _, noise in ways]))
    if moved > max(UNTOUCHED.moved, UNTOUCHED.surely * noise):
        doubt = f"the picture moves by {moved:.1f} px at {at:.0f} s, while nothing touches the object"
        return Untouched("unexplained", moved, at, doubt)
    step, when, usual = _step(recording, own)
    if step > max(UNTOUCHED.step, UNTOUCHED.surely * usual):
        doubt = f"the picture jumps by {step:.1f} px at {when:.0f} s, faster than the hand moves the object"
        return Untouched("unexplained", step, when, doubt)
    return Untouched("no_gap", moved, at)


def _between(recording: TaskRecording, own: Hand) -> Iterator[tuple[float, float]]:
    """(begin, end) s between which the hand is not at the object."""
    begin = recording.seen_from
    for first, last in [*own.touching, (float(recording.log.time[-1]), np.inf)]:
        if first - begin > UNTOUCHED.least:
            yield begin, first
        begin = max(begin, last)


def _way(recording: TaskRecording, begin: float, end: float) -> tuple[float, float, float] | None:
    """px by which the corners together go from their middle place in a stretch, by medians over some images; s at which they are farthest; px
    of noise of such a way, by what corners do each for itself. None where too little is seen."""
    track = recording.track
    taken = track.time + recording.seen_from
    images = np.flatnonzero((taken >= begin) & (taken < end))
    steady = track.usable[images].all(axis=0)
    if len(images) < 3 * UNTOUCHED.window or steady.sum() < UNTOUCHED.corners:
        return None
    smooth = median_filter(track.pixels[images][:, steady], size=(UNTOUCHED.window, 1, 1), mode="nearest")
    off = smooth - np.median(smooth, axis=0)
    together = np.median(off, axis=1)
    noise = np.sqrt(np.pi / 2 * np.mean((off - together[:, None]) ** 2) / steady.sum())  # of a median
    way = np.linalg.norm(together, axis=1)
    return float(way.max()), float(taken[images[way.argmax()]]), float(noise)


def _step(recording: TaskRecording, own: Hand) -> tuple[float, float, float]:
    """px by which the corners together go farther from one image to the next than in those about them, at most, where the hand is slow; s at
    which; px by which they usually do."""
    track = recording.track
    taken = track.time + recording.seen_from
    slow = np.ones(len(taken), bool)
    for begin, end in own.quick:
        slow &= (taken < begin) | (taken > end)
    both = (track.usable[1:] & track.usable[:-1])[..., None]
    steps = np.where(both, np.diff(track.pixels, axis=0), np.nan)
    known = slow[1:] & slow[:-1] & (both[..., 0].sum(axis=1) >= UNTOUCHED.corners)
    known &= np.diff(taken) < THRESHOLDS.track.gap * track.period
    if known.sum() < UNTOUCHED.window:
        return 0.0, 0.0, 0.0
    size = np.linalg.norm(np.nanmedian(steps[known], axis=1), axis=1)
    beyond = size - median_filter(size, size=UNTOUCHED.window, mode="nearest")
    return float(beyond.max()), float(taken[1:][known][beyond.argmax()]), float(1.4826 * np.median(np.abs(beyond)))
