"""How good keypoints are: pixel errors of visible and hidden corners, and whether scores are the
probabilities they claim."""

from __future__ import annotations

import numpy as np

from np_training.detector.network import RELIABLE

BINS = 10
SURE = 0.5  # score from which a keypoint counts as found


def summarise(pixels, scores, truth, visible, present) -> dict:
    """Figures of detections pixels (n, 8, 2) px and scores (n, 8) against truth (n, 8, 2).

    visible (n, 8): the corner is seen; present (n, 8): it counts at all (inside an image that shows the
    object). Errors in px; `calibration_error` is the expected calibration error of the scores; `reliability`
    has, for each tenth of the score, [mean score, share within RELIABLE px, count]. `doubted` are the shares of
    corners with a score below SURE: of those not seen (hidden or absent), and of those not found (farther off
    than RELIABLE px, or absent); `found`: of corners seen, the share with a score of SURE or more.
    """
    pixels, scores, truth = (np.asarray(a, dtype=float) for a in (pixels, scores, truth))
    visible, present = np.asarray(visible, bool), np.asarray(present, bool)
    error = np.linalg.norm(pixels - truth, axis=-1)
    reliable = (error <= RELIABLE) & present
    seen, doubt = visible & present, scores < SURE
    return {
        "images": len(pixels),
        "visible": percentiles(error[seen]),
        "hidden": percentiles(error[~visible & present]),
        "found": share(~doubt[seen]),
        "doubted": {"not_seen": share(doubt[~seen]), "not_found": share(doubt[~reliable])},
        **calibration(scores.ravel(), reliable.ravel()),
    }


def share(values: np.ndarray) -> list | None:
    """[share of True, count] of values (n,); None where there are none."""
    return [round(float(values.mean()), 4), int(values.size)] if values.size else None


def percentiles(error: np.ndarray) -> dict:
    """Count, median, 95th percentile px, and share within RELIABLE px of errors (n,); None where there are
    none."""
    if not error.size:
        return {"count": 0, "median": None, "p95": None, "within": None}
    median, p95 = np.percentile(error, [50, 95])
    return {
        "count": int(error.size),
        "median": round(float(median), 3),
        "p95": round(float(p95), 3),
        "within": round(float((error <= RELIABLE).mean()), 4),
    }


def calibration(scores: np.ndarray, reliable: np.ndarray) -> dict:
    """Expected calibration error and reliability table of scores (n,) for outcomes reliable (n,)."""
    which = np.clip((scores * BINS).astype(int), 0, BINS - 1)
    table, gap = [], 0.0
    for b in range(BINS):
        mine = which == b
        if mine.any():
            mean, share, count = float(scores[mine].mean()), float(reliable[mine].mean()), int(mine.sum())
            table.append([round(mean, 4), round(share, 4), count])
            gap += abs(mean - share) * count / scores.size
    return {"calibration_error": round(gap, 4), "reliability": table}
