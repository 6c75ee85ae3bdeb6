"""The detector's stage: how keypoints scatter about where they are while the object rests, and which images are shown twice.

A corner's deviation is noise with a memory of the image before, or now and then something else altogether: two circular Gaussians,
separated by expectation and maximisation (Dempster, Laird and Rubin 1977).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta

from np_description.keypoints import COUNT
from sim2real.effects import CAMERA_EFFECTS
from sim2real.effects.sentences import ValueWithInterval
from sim2real.recordings.reading import ContractViolation
from sim2real.task.hypotheses import NORMAL_95
from sim2real.task.keypoint_track import KeypointTrack, find_rests
from sim2real.thresholds import THRESHOLDS

SCATTER = THRESHOLDS.keypoint_noise
UNKNOWN = ValueWithInterval(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class KeypointNoise:
    """Scatter of keypoints at rest, each number with its 95 % interval."""

    seconds: float
    """Time s at rest."""
    images: int
    """Images at rest."""
    spread: ValueWithInterval
    """Standard deviation px of a coordinate."""
    memory: ValueWithInterval
    """Correlation with the image before."""
    share: ValueWithInterval
    """Share of corners that are gross errors."""
    size: ValueWithInterval
    """Standard deviation px of gross errors."""
    repeated: ValueWithInterval | None
    """Share of images that repeat the one before; None where nothing moves and nothing scatters."""


def estimate_keypoint_noise(track: KeypointTrack) -> KeypointNoise:
    """Of a recording. Raises ContractViolation where the object rests for too short a time."""
    pieces = find_rests(track)
    seconds = sum(track.time[s.stop - 1] - track.time[s.start] for s in pieces)
    if seconds < SCATTER.least:
        raise ContractViolation(
            f"{track.name}: expected an object that rests for {SCATTER.least:g} s in all, got {seconds:.1f} s in "
            f"{len(pieces)} stretches of {THRESHOLDS.keypoint_track.rest:g} s and more"
        )
    fresh = _is_new_image(track)
    deviations = [_deviations(track, s, fresh[s]) for s in pieces]
    lengths = np.array([len(d) for d in deviations])
    spread, share, size, odds = _fit_mixture(np.concatenate(deviations))
    inside = [
        np.where(o[..., None] < 0.5, d, np.nan) for d, o in zip(deviations, np.split(odds, np.cumsum(lengths)[:-1]))
    ]
    memory, memory_error, spread = _estimate_memory(inside, spread)
    corner_count = int(np.isfinite(odds).sum())
    count = sum(int(np.isfinite(d[..., 0]).sum()) for d in inside)
    lost = sum(np.isfinite(d[..., 0]).any(axis=0).sum() for d in inside)  # a mean of each corner and stretch
    # Of a first-order process the squares have the memory's square for a memory (Bartlett 1946); two coordinates a corner.
    known = 2 * max(count - lost * (1 + memory) / (1 - memory), 1.0) * (1 - memory**2) / (1 + memory**2)
    return KeypointNoise(
        seconds,
        corner_count // COUNT,
        _gaussian_interval(spread, spread / np.sqrt(2 * known)),
        ValueWithInterval(
            memory, max(memory - NORMAL_95 * memory_error, 0.0), min(memory + NORMAL_95 * memory_error, 1.0)
        ),
        _proportion(share * corner_count, corner_count),
        _gaussian_interval(size, size / np.sqrt(2 * 2 * max(share * corner_count, 1.0))),
        _repeated_share(fresh, spread),
    )


def visible_noise_effects(noise: KeypointNoise) -> dict[str, dict[str, ValueWithInterval]]:
    """Parameters of the effects that are visible, by effect: those whose whole interval is beyond the limit that the effect declares."""
    effects = {
        "keypoint_noise": ("spread", {"spread": noise.spread, "memory": noise.memory}),
        "keypoint_outliers": ("share", {"share": noise.share, "size": noise.size}),
        "frame_drop": ("share", {"share": noise.repeated or UNKNOWN}),
    }
    visible = {
        name: values
        for name, (size, values) in effects.items()
        if values[size].low > CAMERA_EFFECTS[name].detection_limit.limit
    }
    if noise.spread.value < SCATTER.noiseless:
        visible.pop("frame_drop", None)  # an object that rests looks the same in every image
    if noise.size.low < SCATTER.gross:  # the long tail of a small scatter does no harm
        visible.pop("keypoint_outliers", None)
    return visible


def _is_new_image(track: KeypointTrack) -> np.ndarray:
    """Images (n,) bool in which anything differs from the one before."""
    same = (track.pixels[1:] == track.pixels[:-1]) | ~np.isfinite(track.pixels[1:])
    return np.r_[True, ~same.all(axis=(1, 2))]


def _deviations(track: KeypointTrack, rest: slice, fresh: np.ndarray) -> np.ndarray:
    """(m, 8, 2) px from the median of each corner, NaN where it is not usable or the image is repeated."""
    pixels = np.where(track.usable[rest][..., None], track.pixels[rest], np.nan)
    if fresh[1:].any():  # else nothing scatters at all
        pixels[~fresh] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a corner that is never usable has no median
        return pixels - np.nanmedian(pixels, axis=0)


def _fit_mixture(deviations: np.ndarray) -> tuple[float, float, float, np.ndarray]:
    """(spread px, share, size px, odds (n, 8) of being something else) of two circular Gaussians; a share of 0 where one does."""
    square = np.square(deviations).sum(axis=-1)
    known = square[np.isfinite(square)]
    single = max(np.sqrt(np.median(known) / (2 * np.log(2))), SCATTER.finest)  # median of a Rayleigh's square
    spread, share, size = single, 0.02, SCATTER.wide * single
    for _ in range(SCATTER.rounds):
        heavy = share / size**2 * np.exp(-known / (2 * size**2))
        odds = heavy / (heavy + (1 - share) / spread**2 * np.exp(-known / (2 * spread**2)) + 1e-300)
        share = float(odds.mean())
        spread = max(np.sqrt((known * (1 - odds)).sum() / (2 * max((1 - odds).sum(), 1e-9))), SCATTER.finest)
        size = max(np.sqrt((known * odds).sum() / (2 * max(odds.sum(), 1e-9))), spread)
        share = min(max(share, 1e-9), 0.5)
    alone = np.sqrt(known.mean() / 2)
    two = np.log(
        (1 - share) / spread**2 * np.exp(-known / (2 * spread**2))
        + share / size**2 * np.exp(-known / (2 * size**2))
        + 1e-300
    )
    one = -2 * np.log(max(alone, SCATTER.finest)) - known / (2 * max(alone, SCATTER.finest) ** 2)
    if two.sum() - one.sum() < SCATTER.surely or size < SCATTER.apart * spread:
        return max(alone, SCATTER.finest), 0.0, 0.0, np.where(np.isfinite(square), 0.0, np.nan)
    all_odds = np.full(square.shape, np.nan)
    all_odds[np.isfinite(square)] = odds
    return spread, share, size, all_odds


def _estimate_memory(inside: Sequence[np.ndarray], spread: float) -> tuple[float, float, float]:
    """(correlation of a deviation with that of the image before, its standard error, spread px) of stretches whose means were taken from
    themselves: both are too small by what the mean takes, which is put back."""
    stretches = [d for d in inside if len(d) > 1]
    products = [(d[:-1] * d[1:]).ravel() for d in stretches]
    counts = np.array([np.isfinite(p).sum() for p in products])
    power = np.nanmean(np.concatenate([np.square(d).ravel() for d in inside]))
    if counts.sum() < SCATTER.pairs or power <= SCATTER.finest**2:
        return 0.0, 0.0, spread
    own = np.array([np.nansum(p) for p in products]) / (counts * power)
    raw = float(np.clip(np.average(own, weights=counts), 0.0, SCATTER.longest))
    length = float(np.average([len(d) for d in stretches], weights=counts))
    memory = taken = 0.0
    for _ in range(SCATTER.rounds):  # of a mean over n images, (1 + memory) / (1 - memory) / n of the power is lost
        taken = min((1 + memory) / (1 - memory) / length, SCATTER.taken)
        memory = float(np.clip(raw * (1 - taken) + taken, 0.0, SCATTER.longest)) if raw else 0.0
    # Stretches differ by more than chance: in some the object still creeps.
    among = np.sqrt(np.average(np.square(own - raw), weights=counts) / max(len(own) - 1, 1))
    return memory, float(max(among, np.sqrt((1 - memory**2) / counts.sum()))), spread / np.sqrt(1 - taken)


def _repeated_share(fresh: np.ndarray, spread: float) -> ValueWithInterval | None:
    """Of all images where corners scatter; else of those between two that differ, which are not so far apart that it rested."""
    if spread > SCATTER.finest:
        return _proportion(float((~fresh[1:]).sum()), len(fresh) - 1)
    between = np.diff(np.flatnonzero(fresh[1:]))
    between = between[between <= SCATTER.rested]
    if between.sum() < SCATTER.pairs:
        return None
    return _proportion(float((between - 1).sum()), int(between.sum()))


def _proportion(count: float, of: int) -> ValueWithInterval:
    """Clopper and Pearson's interval."""
    low = beta.ppf(0.025, count, of - count + 1) if count > 0 else 0.0
    high = beta.ppf(0.975, count + 1, of - count) if count < of else 1.0
    return ValueWithInterval(count / of, float(low), float(high))


def _gaussian_interval(value: float, error: float) -> ValueWithInterval:
    return ValueWithInterval(float(value), float(max(value - NORMAL_95 * error, 0.0)), float(value + NORMAL_95 * error))
