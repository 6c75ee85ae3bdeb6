"""A baseline of the chain's set: CMA-ES over all parameters at once, by how the object moves.

What is minimised is the error of the motion in the recording that the doctor hears (`chain.motion`), of which seven numbers decide. Nothing
competes and nothing is a class: what comes out beyond the limit of its effect is named. Needs `cma` (`pip install cma`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.task.object_motion.stage import errors
from sim2real.task.suite.recording import TaskRecording

from np_blind.chain.cases import RECORDS
from np_blind.chain.others import Told


@dataclass(frozen=True)
class Number:
    """One parameter. effect, quantity: as a patch has it; spread: what a step of one is, about what a gap is; low, high: bounds."""

    effect: str
    quantity: str
    spread: float
    low: float
    high: float


NUMBERS = (
    Number("table_friction", "relative", 0.2, -0.7, 1.0),
    Number("object_mass", "relative", 0.2, -0.7, 1.0),
    Number("gripper_friction", "relative", 0.2, -0.7, 0.5),
    Number("table_height", "height", 0.004, -0.015, 0.015),
    Number("camera_extrinsics", "x", 0.005, -0.03, 0.03),
    Number("camera_extrinsics", "y", 0.005, -0.03, 0.03),
    Number("camera_latency", "delay", 0.02, 0.0, 0.12),
)
WORST = 20.0  # px, of a window that cannot be predicted


def ask(recording: TaskRecording, seed: int, seconds: float) -> Told:
    """What CMA-ES makes of a recording in so many seconds."""
    x, left, evaluations = search(recording, seconds, seed)
    found = {f"{n.effect} {n.quantity}": float(step * n.spread) for n, step in zip(NUMBERS, x)}
    patch = patch_of(x)
    return Told(named(x), found, lambda fresh: errors(fresh, patch), {"left": left, "evaluations": evaluations})


def search(recording: TaskRecording, seconds: float, seed: int) -> tuple[np.ndarray, float, int]:
    """Numbers (7,), px of the error of the motion that they leave, and how often it was asked. Ends after so many seconds at the latest."""
    import cma  # takes two seconds

    def off(x: np.ndarray) -> float:
        found = errors([recording], patch_of(x), rougher=(0.0,))
        return float(np.where(np.isfinite(found), found, WORST).mean())

    low, high = ([getattr(n, side) / n.spread for n in NUMBERS] for side in ("low", "high"))
    asked = cma.CMAEvolutionStrategy(
        np.zeros(len(NUMBERS)),
        0.5,
        {"bounds": [low, high], "seed": seed + 1, "timeout": seconds, "verbose": -9, "maxiter": 200},
    )
    asked.optimize(off)
    best = asked.result
    return np.asarray(best.xbest), float(best.fbest), int(best.evaluations)


def patch_of(x: Sequence[float]) -> Patch:
    """The patch of numbers (7,) in steps of their spreads."""
    values: dict[str, dict[str, float]] = {}
    for number, step in zip(NUMBERS, x):
        value = min(max(float(step) * number.spread, number.low), number.high)
        values.setdefault(number.effect, {})[number.quantity] = value
    return Patch(tuple(PatchEffect(effect, str(RECORDS[effect].part), given) for effect, given in values.items()))


def named(x: Sequence[float]) -> list[str]:
    """Effects of which a number is beyond the limit that the effect declares."""
    beyond = (n.effect for n, step in zip(NUMBERS, x) if abs(step * n.spread) > RECORDS[n.effect].seen.limit)
    return sorted(set(beyond))
