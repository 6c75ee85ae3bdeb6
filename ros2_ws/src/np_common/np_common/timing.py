"""Duration of a call, in the form of the benches."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np


def milliseconds(action: Callable[[], object], repeats: int) -> dict[str, float]:
    """p50, p95 ms of calling `action`, after three calls that do not count."""
    for _ in range(3):
        action()
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        action()
        seconds.append(time.perf_counter() - began)
    p50, p95 = np.percentile(seconds, (50, 95)) * 1e3
    return {"p50_ms": round(float(p50), 3), "p95_ms": round(float(p95), 3)}
