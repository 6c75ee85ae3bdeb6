"""The summary of a finetuning: success by cell, losses, costs of effects, and the choice of policies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from sim2real.effects.patch import Patch

from np_common.intervals import wilson_interval
from np_evaluation.calibration_corrections import corrections
from np_evaluation.finetune.learning import split_trainable
from np_evaluation.finetune.rollouts import succeeds
from np_evaluation.finetune.shapley_values import mean_and_interval

KEPT = {"before": "patched", "corrected": "patched_corrected", "trained": "patched_after"}
"""The choices, and the cell that each is judged by: the old policies, these with corrections, or the new policies."""


def summarize(
    domain: str,
    episodes: int,
    reality: str | None,
    patch: Patch,
    scores: Mapping[str, Sequence[float]],
    costs: Mapping[str, dict],
    learned: dict | None,
) -> dict:
    """The result of finetuning as JSON.

    reality: engine of the robot that it is judged by besides; scores: by cell; costs: of parts of the patch; learned: the
    training's result, None where there was none.
    """
    success = {name: _rate(succeeds(each)) for name, each in scores.items()}
    remaining = corrections(patch).remaining
    left_out = split_trainable(remaining)[1]
    # The best is chosen in the simulator with the patch: reality is measured once, and not to choose.
    kept = max((k for k, name in KEPT.items() if name in scores), key=lambda k: sum(scores[KEPT[k]]))
    lost = _paired_difference(scores["nominal"], scores["patched"])
    returned = None if kept == "before" else _paired_difference(scores[KEPT[kept]], scores["patched"])
    cause = next((name for name, cost in costs.items() if cost["score"]["value"] > 0 or len(costs) == 1), None)
    value = {name: rate["value"] for name, rate in success.items()}
    return {
        "success_nominal": value["nominal"],
        "success_predicted": value["patched"],
        "success_before": value.get("reality"),
        "success_after": value.get(KEPT[kept].replace("patched", "reality")),
        "success_after_predicted": value[KEPT[kept]],
        "cause": cause,
        "costs": costs,
        "lost": lost,
        "returned": returned,
        "kept": kept,
        "effects": [f"{e.effect} at {e.component}" for e in patch.effects],
        "corrected": [f"{e.effect} at {e.component}" for e in patch.effects if e not in remaining.effects],
        "not_trained": left_out,
        "success": success,
        "learned": learned,
        "domain": domain,
        "episodes": episodes,
        "reality": reality,
        "weights": learned["chosen"] if learned else None,
    }


def _rate(each: Sequence[bool]) -> dict:
    return {"value": sum(each) / len(each), "ci95": list(wilson_interval(sum(each), len(each))), "of": len(each)}


def _paired_difference(more: Sequence[float], less: Sequence[float]) -> dict:
    """Difference of two successes on the same episodes, of which these are the scores."""
    return mean_and_interval(np.array(succeeds(more), float) - np.array(succeeds(less), float))
