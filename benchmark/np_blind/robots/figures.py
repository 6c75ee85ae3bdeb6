"""Figures of the withheld robots: is the cause named, how much comes back, is anybody worse off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import spearmanr

from np_blind.robots.prediction import DRAWS, ENOUGH, prediction_figures
from np_common.intervals import wilson_interval
from np_evaluation.finetune.shapley_values import mean_and_interval

LEAST_LOSS = 0.05  # of success, below which there is nothing to return
STAGES = {"patched": "before", "patched_corrected": "corrected", "patched_after": "after"}
"""What the patched simulator predicts of a robot, and what it is called in PhysX."""


def figures(rows: Sequence[Mapping]) -> dict:
    """By name: value, of; None where no robot came so far."""
    judged = [row for row in rows if "ablation" in row and "costs" in row]
    done = [row for row in judged if "adopted" in row["engine"]]  # others were not trained yet
    trained = [row for row in done if row["engine"]["after"] is not None]
    oracle = [row for row in done if row["engine"].get("oracle")]
    named = [named_top(row) for row in judged]
    pairs = [pair for row in judged for pair in cost_pairs(row)]
    ablated = [p for row in judged if "ablation_scores" in row for p in cost_pairs(row, "taken_out", "ablation_scores")]
    worse = [_gained(row["engine"]["adopted"], row) for row in done]
    return {
        "top cause named": {
            "value": _mean(named),
            "ci95": list(wilson_interval(sum(named), len(named))),
            "of": len(named),
        },
        "rank correlation of costs with ablation": _rank(pairs),
        "rank correlation of ablations, by scores": _rank(ablated),
        "lost success that returns, median": _returns([row for row in done if _loss(row) > LEAST_LOSS], "adopted"),
        "with corrections alone, median": _returns(
            [row for row in done if _loss(row) > LEAST_LOSS and "corrected" in row["engine"]], "corrected"
        ),
        "of the oracle's, median": _returns(
            [row for row in oracle if _share(row, "oracle") > LEAST_LOSS], "adopted", "oracle"
        ),
        "the oracle's own return, median": _returns([row for row in oracle if _loss(row) > LEAST_LOSS], "oracle"),
        **prediction_of_stages(judged),
        "worse than before": {"value": sum(each["value"] < 0 for each in worse), "of": len(worse)},
        "worse beyond doubt": {"value": sum(each["ci95"][1] < 0 for each in worse), "of": len(worse)},
        "new policies adopted": {"value": sum(_has_new(row) for row in trained), "of": len(trained)},
        "not finished": {"value": sum(bool(row.get("error")) for row in rows), "of": len(rows)},
    }


def named_top(row: Mapping) -> bool:
    """Whether the effect that a rehearsal blames is the one that costs most in PhysX."""
    top = max(row["ablation"], key=row["ablation"].get)
    return row["cause"] is not None and row["cause"].partition(" at ")[0] == top


def cost_pairs(row: Mapping, kind: str = "score", real: str = "ablation") -> list[tuple[float, float]]:
    """(cost by the rehearsal, cost in PhysX) of each true effect; one that was not found costs nothing. kind, real: which
    of the figures of either."""
    costs: dict[str, float] = {}
    for name, cost in row["costs"].items():
        effect = name.partition(" at ")[0]
        costs[effect] = costs.get(effect, 0.0) + cost.get(kind, cost)["value"]
    return [(costs.get(effect, 0.0), cost) for effect, cost in row[real].items()]


def _has_new(row: Mapping) -> bool:
    return row["kept"] == "trained" if "kept" in row else bool(row["adopted"])


def _loss(row: Mapping) -> float:
    return float(np.mean(row["engine"]["nominal"]) - np.mean(row["engine"]["before"]))


def _share(row: Mapping, after: str, of: str = "nominal", numbers: Sequence[int] | slice = slice(None)) -> float:
    """What of the success between `before` and `of` there is with `after`, in some episodes; where nothing was found, that is `before`."""
    engine = row["engine"]
    before, gained, most = (
        float(np.mean(np.array(engine[name] or engine["before"], float)[numbers])) for name in ("before", after, of)
    )
    return (gained - before) / max(most - before, 1e-9)


def _returns(rows: Sequence[Mapping], after: str, of: str = "nominal") -> dict:
    """Median share over robots, with its 95 % interval by the bootstrap over robots and the pairs of each."""
    result = _median([_share(row, after, of) for row in rows])
    if len(rows) < ENOUGH:
        return result
    rng, medians = np.random.default_rng(0), []
    for _ in range(DRAWS):
        some = (rows[i] for i in rng.integers(len(rows), size=len(rows)))
        medians.append(np.median([_share(row, after, of, _drawn(rng, row)) for row in some]))
    return {**result, "ci95": np.quantile(medians, [0.025, 0.975]).tolist()}


def _drawn(rng: np.random.Generator, row: Mapping) -> np.ndarray:
    """Numbers of a robot's episodes, as many as it has, with repetition."""
    count = len(row["engine"]["before"])
    return rng.integers(count, size=count)


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
    result = {"value": float(spearmanr(*both.T).statistic), "of": len(both)}
    if len(both) < ENOUGH:
        return result
    drawn = (both[rows] for rows in np.random.default_rng(0).integers(len(both), size=(DRAWS, len(both))))
    found = [spearmanr(*some.T).statistic for some in drawn if np.ptp(some, axis=0).all()]
    low, high = np.quantile(found, [0.025, 0.975])
    return {**result, "ci95": [float(low), float(high)]}


def prediction_of_stages(rows: Sequence[Mapping]) -> dict:
    """What the patched simulator predicts of robots as they are, corrected, and with new policies, beside PhysX."""
    own = []
    for row in rows:
        pairs = [
            (row["success"][predicted]["value"], float(np.mean(row["engine"][real])))
            for predicted, real in STAGES.items()
            if predicted in row.get("success", {}) and row["engine"].get(real)
        ]
        own += [np.array(pairs)] if pairs else []
    found = prediction_figures(own) if own else {}
    texts = {"r": "r of stages", "mean_absolute_error": "mean error of stages", "mmrv": "MMRV of stages"}
    count = sum(map(len, own))
    return {
        text: {"value": found.get(name), "of": count}
        | ({"ci95": found[f"{name}_ci95"]} if f"{name}_ci95" in found else {})
        for name, text in texts.items()
    }
