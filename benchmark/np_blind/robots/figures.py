"""Figures of the withheld robots: is the cause named, how much comes back, is anybody worse off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import spearmanr

from np_bringup.rehearsal.shares import mean_and_interval
from np_record.intervals import wilson_interval

DRAWS, ENOUGH = 1000, 6  # of the bootstrap over effects, and how many these have to be
LEAST_LOSS = 0.05  # of success, below which there is nothing to return


def figures(rows: Sequence[Mapping]) -> dict:
    """By name: value, of; None where no robot came so far."""
    judged = [row for row in rows if "ablation" in row and "costs" in row]
    done = [row for row in judged if "adopted" in row["engine"]]  # others were not trained yet
    trained = [row for row in done if row["engine"]["after"] is not None]
    oracle = [row for row in done if row["engine"].get("oracle")]
    named = [named_top(row) for row in judged]
    pairs = [pair for row in judged for pair in cost_pairs(row)]
    worse = [_gained(row["engine"]["adopted"], row) for row in done]
    return {
        "top cause named": {
            "value": _mean(named),
            "ci95": list(wilson_interval(sum(named), len(named))),
            "of": len(named),
        },
        "rank correlation of costs with ablation": _rank(pairs),
        "lost success that returns, median": _median(
            [_returned(row, row["engine"]["adopted"]) for row in done if _loss(row) > LEAST_LOSS]
        ),
        "with corrections alone, median": _median(
            [
                _returned(row, row["engine"].get("corrected") or row["engine"]["before"])
                for row in done
                if _loss(row) > LEAST_LOSS and "corrected" in row["engine"]
            ]
        ),
        "of the oracle's, median": _median(
            [
                float(np.mean(row["engine"]["adopted"]) - np.mean(row["engine"]["before"]))
                / max(float(np.mean(row["engine"]["oracle"]) - np.mean(row["engine"]["before"])), 1e-9)
                for row in oracle
                if _returned(row, row["engine"]["oracle"]) > LEAST_LOSS
            ]
        ),
        "the oracle's own return, median": _median(
            [_returned(row, row["engine"]["oracle"]) for row in oracle if _loss(row) > LEAST_LOSS]
        ),
        "worse than before": {"value": sum(each["value"] < 0 for each in worse), "of": len(worse)},
        "worse beyond doubt": {"value": sum(each["ci95"][1] < 0 for each in worse), "of": len(worse)},
        "new policies adopted": {"value": sum(_has_new(row) for row in trained), "of": len(trained)},
        "not finished": {"value": sum(bool(row.get("error")) for row in rows), "of": len(rows)},
    }


def named_top(row: Mapping) -> bool:
    """Whether the effect that a rehearsal blames is the one that costs most in PhysX."""
    top = max(row["ablation"], key=row["ablation"].get)
    return row["cause"] is not None and row["cause"].partition(" at ")[0] == top


def cost_pairs(row: Mapping) -> list[tuple[float, float]]:
    """(what a rehearsal says that it costs, what it costs in PhysX) of each true effect; one that was not found costs nothing."""
    said: dict[str, float] = {}
    for name, cost in row["costs"].items():
        effect = name.partition(" at ")[0]
        said[effect] = said.get(effect, 0.0) + cost.get("score", cost)["value"]
    return [(said.get(effect, 0.0), cost) for effect, cost in row["ablation"].items()]


def _has_new(row: Mapping) -> bool:
    return row["kept"] == "trained" if "kept" in row else bool(row["adopted"])


def _loss(row: Mapping) -> float:
    return float(np.mean(row["engine"]["nominal"]) - np.mean(row["engine"]["before"]))


def _returned(row: Mapping, after: Sequence[bool]) -> float:
    return float(np.mean(after) - np.mean(row["engine"]["before"])) / max(_loss(row), 1e-9)


def _gained(after: Sequence[bool], row: Mapping) -> dict:
    return mean_and_interval(np.array(after, float) - np.array(row["engine"]["before"], float))


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _median(values: Sequence[float]) -> dict:
    return {
        "value": float(np.median(values)) if values else None,
        "each": [round(v, 3) for v in values],
        "of": len(values),
    }


def _rank(pairs: Sequence[tuple[float, float]]) -> dict:
    """Spearman's rank correlation, with its 95 % interval by the bootstrap over effects."""
    both = np.array(pairs, float).reshape(-1, 2)
    if len(both) <= 2 or not np.ptp(both, axis=0).all():
        return {"value": None, "of": len(both)}
    told = {"value": float(spearmanr(*both.T).statistic), "of": len(both)}
    if len(both) < ENOUGH:
        return told
    drawn = (both[rows] for rows in np.random.default_rng(0).integers(len(both), size=(DRAWS, len(both))))
    found = [spearmanr(*some.T).statistic for some in drawn if np.ptp(some, axis=0).all()]
    low, high = np.quantile(found, [0.025, 0.975])
    return {**told, "ci95": [float(low), float(high)]}


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
