"""The statistics that LeRobot keeps of a feature, by which a learner scales it."""

from __future__ import annotations

import numpy as np

_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_STEP = 16  # of an image, one pixel in this many counts, in each direction


def summarize(values: np.ndarray) -> dict[str, list]:
    """Of values (n, numbers): min, max, mean, std, quantiles, each a list of that many, and count [n]."""
    return _summary(values.astype(float), len(values))


def sample_pixels(images: np.ndarray) -> np.ndarray:
    """What counts of images (n, height, width, 3): some of their pixels."""
    return images[:, ::_STEP, ::_STEP].copy()


def summarize_images(pixels: np.ndarray) -> dict[str, list]:
    """Of `sample_pixels` images uint8, as shares of full brightness: by colour, nested as (3, 1, 1)."""
    summary = _summary(pixels.reshape(-1, 3) / 255.0, len(pixels))
    return {name: value if name == "count" else [[[v]] for v in value] for name, value in summary.items()}


def _summary(values: np.ndarray, count: int) -> dict[str, list]:
    quantiles = np.quantile(values, list(_QUANTILES.values()), axis=0)
    return {
        "min": values.min(0).tolist(),
        "max": values.max(0).tolist(),
        "mean": values.mean(0).tolist(),
        "std": values.std(0).tolist(),
        "count": [count],
        **{name: row.tolist() for name, row in zip(_QUANTILES, quantiles)},
    }
