"""What touch and force found, in words, as JSON and as a patch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np

from sim2real.effects import SCENE_EFFECTS
from sim2real.effects.sentences import ValueWithInterval, describe_effect
from sim2real.task.contact_force.estimate import ContactForceResult
from sim2real.task.hypotheses import HypothesisComparison
from sim2real.task.surface.estimate import SurfaceContactResult

PARAMETERS = {
    "table_height": "height",
    "table_friction": "relative",
    "object_mass": "relative",
    "gripper_friction": "relative",
}
"""What a patch calls the one number of an effect that a scene carries."""
RELATIVE = "relative"


def document(touched: SurfaceContactResult, forced: ContactForceResult) -> dict:
    """The answer of both stages; SI units, intervals of 95 %."""
    touch = {
        "verdict": touched.verdict,
        "doubt": touched.doubt,
        **_explained(touched.explained),
        "touches": [
            {"name": t.name, "place_m": t.place.tolist(), "height_m": t.height, "force_n": t.force}
            for t in touched.touches
        ],
        "held_out_mm": _held_out(touched.before, touched.after, 1e3),
    }
    force = {
        "verdict": forced.verdict,
        "doubt": forced.doubt,
        **_explained(forced.explained),
        "measured": {name: dict(zip(("value", "low", "high"), v)) for name, v in (forced.measured or {}).items()},
        "least_finger": forced.least_finger,
        "readings": [asdict(r) for r in forced.readings],
        "held_out_n": _held_out(forced.before, forced.after, 1.0),
    }
    return {"touch": touch, "force": force}


def effect_text(effect: str, sizes: Mapping[str, ValueWithInterval]) -> str:
    """An effect with its sizes, as half a sentence."""
    if effect in SCENE_EFFECTS:
        return describe_effect(
            SCENE_EFFECTS[effect], str(SCENE_EFFECTS[effect].target), patch_values(effect, sizes), "the simulator"
        )
    return f"{effect.replace('_', ' ')}: " + ", ".join(f"{name} {value:SI}" for name, value in sizes.items())


def patch_values(effect: str, sizes: Mapping[str, ValueWithInterval]) -> dict[str, ValueWithInterval]:
    """Numbers as a patch has them: a logarithm as a share."""
    (value,) = sizes.values()
    if PARAMETERS[effect] == RELATIVE:
        value = ValueWithInterval(*(float(np.expm1(number)) for number in (value.value, value.low, value.high)))
    return {PARAMETERS[effect]: value}


def _explained(explained: HypothesisComparison | None) -> dict:
    if explained is None:
        return {"named": [], "bounds": {}, "unseen": []}
    return {
        "named": [asdict(one) for one in explained.named],
        "bounds": {name: asdict(value) for name, value in explained.bounds.items()},
        "unseen": list(explained.unseen),
    }


def _held_out(before: float | None, after: float | None, scale: float) -> dict | None:
    return None if before is None or after is None else {"before": scale * before, "after": scale * after}
