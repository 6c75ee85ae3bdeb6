"""How well success that was predicted is that which came: Pearson's r, MMRV, the mean error, with intervals over robots."""

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


def prediction_figures(own: Sequence[np.ndarray]) -> dict:
    """`r` and `mean_absolute_error` over all pairs, `mmrv` in the mean over robots; where these are enough, `_ci95` of each by the bootstrap over
    robots. own: of each robot (n, 2) success predicted, and measured."""

    violations = [mmrv(*pairs.T) for pairs in own]
    found = _figures(own, violations)
    if len(own) < ENOUGH:
        return found
    some = np.random.default_rng(0).integers(len(own), size=(DRAWS, len(own)))
    drawn = [_figures([own[i] for i in these], [violations[i] for i in these]) for these in some]
    return found | {f"{name}_ci95": _quantiles(drawn, name, (0.025, 0.975)) for name in found}


def exact_prediction_figures(own: Sequence[np.ndarray], episodes: int) -> dict:
    """What these figures would be of a simulator whose rates of success are reality's, by so many episodes a share: medians, and `_ci95` over draws.

    Rates are taken to be the means of both columns, and both are drawn anew, each by itself. Such rates hold noise and lie farther apart than true
    ones, which makes these figures rather too good; tasks that both sides play, and fail together, make them rather too bad.
    """
    random = np.random.default_rng(0)
    rates = [np.repeat(pairs.mean(axis=1, keepdims=True), 2, axis=1) for pairs in own]
    drawn = []
    for _ in range(DRAWS):
        anew = [random.binomial(episodes, p) / episodes for p in rates]
        drawn.append(_figures(anew, [mmrv(*pairs.T) for pairs in anew]))
    found = {}
    for name in drawn[0]:
        low, median, high = _quantiles(drawn, name, (0.025, 0.5, 0.975)) or (None,) * 3
        found |= {name: median, f"{name}_ci95": [low, high]}
    return found


def _figures(own: Sequence[np.ndarray], violations: Sequence[float]) -> dict:
    whole = np.concatenate(own)
    error = float(np.abs(whole[:, 0] - whole[:, 1]).mean())
    return {"r": pearson(*whole.T), "mean_absolute_error": error, "mmrv": float(np.mean(violations))}


def _quantiles(drawn: Sequence[dict], name: str, of: Sequence[float]) -> list[float] | None:
    known = [figures[name] for figures in drawn if figures[name] is not None]
    return np.quantile(known, of).tolist() if known else None
