"""Touches and contact forces in words and as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from sim2real.effects import SCENE_EFFECTS
from sim2real.effects.sentences import ValueWithInterval, describe_effect
from sim2real.task.contact_force.estimate import ContactForceResult
from sim2real.task.findings import patch_values
from sim2real.task.hypotheses import HypothesisComparison, TaskFinding
from sim2real.task.surface.estimate import SurfaceContactResult


def document(surfaces: SurfaceContactResult, forces: ContactForceResult) -> dict:
    """Both stages in SI units, with 95 % intervals."""
    touch = {
        "verdict": surfaces.verdict,
        "doubt": surfaces.abstention_reason,
        **_comparison(surfaces.comparison),
        "touches": [
            {"name": t.name, "place_m": t.place.tolist(), "height_m": t.height, "force_n": t.force}
            for t in surfaces.touches
        ],
        "held_out_mm": _held_out(surfaces.before, surfaces.after, 1e3),
    }
    force = {
        "verdict": forces.verdict,
        "doubt": forces.abstention_reason,
        **_comparison(forces.comparison),
        "measured": {name: dict(zip(("value", "low", "high"), v)) for name, v in (forces.measured or {}).items()},
        "least_finger": forces.least_finger,
        "readings": [asdict(r) for r in forces.readings],
        "held_out_n": _held_out(forces.before, forces.after, 1.0),
    }
    return {"touch": touch, "force": force}


def effect_text(effect: str, estimates: Mapping[str, ValueWithInterval]) -> str:
    """An effect with its parameters, as half a sentence."""
    if effect in SCENE_EFFECTS:
        record = SCENE_EFFECTS[effect]
        return describe_effect(record, str(record.target), patch_values(effect, estimates), "the simulator")
    return f"{effect.replace('_', ' ')}: " + ", ".join(f"{name} {value:SI}" for name, value in estimates.items())


def _comparison(comparison: HypothesisComparison | None) -> dict:
    if comparison is None:
        return {"named": [], "bounds": {}, "unseen": []}
    return {
        "named": [_finding(one) for one in comparison.findings],
        "bounds": {name: asdict(value) for name, value in comparison.bounds.items()},
        "unseen": list(comparison.unidentifiable),
    }


def _finding(one: TaskFinding) -> dict:
    sizes = {
        hypothesis.name: {name: asdict(value) for name, value in hypothesis.estimates.items()}
        for hypothesis in one.hypotheses
    }
    effect = one.hypotheses[0].name
    rivals = {name: values for name, values in sizes.items() if name != effect}
    return {"effect": effect, "sizes": sizes[effect], "gain": one.log_bayes_factor, "rivals": rivals}


def _held_out(before: float | None, after: float | None, scale: float) -> dict | None:
    return None if before is None or after is None else {"before": scale * before, "after": scale * after}
