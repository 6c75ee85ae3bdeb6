"""How well success that was foretold is that which came: Pearson's r, MMRV, the mean error, with intervals over robots."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

DRAWS, ENOUGH = 1000, 6  # of the bootstrap over effects or robots, and how many these have to be


def pearson(predicted: Sequence[float], real: Sequence[float]) -> float | None:
    """Pearson's r of success predicted and measured; None where one of them does not vary."""
    if len(predicted) < 2 or np.ptp(predicted) == 0 or np.ptp(real) == 0:
        return None
    return float(np.corrcoef(predicted, real)[0, 1])


def mmrv(predicted: Sequence[float], real: Sequence[float]) -> float:
    """Mean maximum rank violation of policies (Li et al., Evaluating real-world robot manipulation policies in simulation, 2024): of each policy
    the largest difference in reality to another one that the simulator ranks the other way round, on average."""
    p, r = np.asarray(predicted, float), np.asarray(real, float)
    violated = (p[:, None] < p[None]) != (r[:, None] < r[None])
    return float((np.abs(r[:, None] - r[None]) * violated).max(axis=1).mean())


def predicted(own: Sequence[np.ndarray]) -> dict:
    """`r` and `mean_absolute_error` over all pairs, `mmrv` in the mean over robots; where these are enough, `_ci95` of each by the bootstrap over
    robots. own: of each robot (n, 2) success foretold, and measured."""

    def told(some: Sequence[int]) -> tuple[float | None, float, float]:
        whole = np.concatenate([own[i] for i in some])
        error = float(np.abs(whole[:, 0] - whole[:, 1]).mean())
        return pearson(*whole.T), error, float(np.mean([violations[i] for i in some]))

    violations = [mmrv(*pairs.T) for pairs in own]
    names = ("r", "mean_absolute_error", "mmrv")
    found = dict(zip(names, told(range(len(own)))))
    if len(own) < ENOUGH:
        return found
    drawn = [told(some) for some in np.random.default_rng(0).integers(len(own), size=(DRAWS, len(own)))]
    for name, values in zip(names, zip(*drawn)):
        known = [value for value in values if value is not None]
        found[f"{name}_ci95"] = np.quantile(known, [0.025, 0.975]).tolist() if known else None
    return found
