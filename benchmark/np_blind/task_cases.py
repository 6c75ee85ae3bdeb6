"""Cases of the chain's blind set: the task suite in PhysX, with a background that is always on, and a gap, or none.

The key is a function of (cases, seed) alone and needs no simulation, so that its hash can be put down before anything is recorded.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from math import radians

import numpy as np

from np_blind.sealed import SCHEMA
from np_description.panda import NOMINAL
from np_effects import SCENE_RECORDS, VIEW_RECORDS
from np_effects.patch import Patch, PatchEffect

SET = "task"
OUT = "out_of_catalogue"
KNOCKED_AT = 60.0  # s, at which a camera is knocked: after touches and drags, before the pushes
MEMORY = 0.8  # of a detector's error, from image to image
GROSS = 6.0  # px, of a corner that is wrong


@dataclass(frozen=True)
class Case:
    """kind: an effect of the catalogue, clean, or out of it; gap: parameters of the effect, or of what is out of the catalogue; usual:
    what any set-up has besides, by effect, component and parameters."""

    number: int
    kind: str
    gap: dict[str, float] = field(default_factory=dict)
    usual: tuple[tuple[str, str, dict[str, float]], ...] = ()

    @property
    def is_known(self) -> bool:
        """Whether the gap is an effect of the catalogue."""
        return self.kind in RECORDS

    @property
    def patch(self) -> Patch:
        """What is other than believed, but for what is out of the catalogue."""
        own = [PatchEffect(self.kind, str(RECORDS[self.kind].part), self.gap)] if self.is_known else []
        return Patch((*own, *(PatchEffect(*one) for one in self.usual)))


RECORDS = {**SCENE_RECORDS, **VIEW_RECORDS}


def _either(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.choice([-1.0, 1.0]) * rng.uniform(low, high))


def _aside(rng: np.random.Generator) -> dict[str, float]:
    way = rng.uniform(0, 2 * np.pi)
    size = rng.uniform(3, 8) * 0.002
    return {"x": size * float(np.cos(way)), "y": size * float(np.sin(way))}


GAPS: dict[str, Callable[[np.random.Generator], dict[str, float]]] = {
    "clean": lambda rng: {},
    "table_height": lambda rng: {"height": _either(rng, 0.003, 0.008)},
    "object_mass": lambda rng: {"relative": _either(rng, 0.3, 0.5)},
    "table_friction": lambda rng: {"relative": _either(rng, 0.24, 0.45)},
    "gripper_friction": lambda rng: {"relative": -float(rng.uniform(0.35, 0.6))},
    "camera_extrinsics": _aside,
    "camera_latency": lambda rng: {"delay": float(rng.uniform(0.009, 0.06))},
    "cable": lambda rng: {"pull": float(rng.uniform(0.25, 0.45)), "way": float(rng.uniform(-np.pi, np.pi))},
    "knocked": lambda rng: {"turn": _either(rng, radians(0.5), radians(1.0))},
}
"""Of 3 to 8 times the limit of an effect, as far as a simulator takes it. cable: N, that pulls the object all the time, in a direction rad;
knocked: rad, by which the camera turns to the side at KNOCKED_AT."""
OUT_OF_CATALOGUE = ("cable", "knocked")
ORDER = (
    "clean", "table_height", "object_mass", "table_friction", "clean", "camera_extrinsics", "gripper_friction", "camera_latency", "clean",
    "cable", "table_height", "object_mass", "clean", "table_friction", "knocked", "camera_extrinsics",
)  # fmt: skip
"""Kinds of a set, over and over: any beginning of it has some of all."""


def draw(count: int, seed: int) -> list[Case]:
    """So many cases of a set."""
    return [_case(number, ORDER[number % len(ORDER)], seed) for number in range(count)]


def _case(number: int, kind: str, seed: int) -> Case:
    rng = np.random.default_rng([seed, number])
    gap = {name: float(f"{value:.9g}") for name, value in GAPS[kind](rng).items()}
    scene = [
        ("object_mass", "object", {"relative": 0.01 * rng.standard_normal()}),
        ("table_friction", "contact", {"relative": 0.03 * rng.standard_normal()}),
        ("table_height", "environment", {"height": 0.0002 * rng.standard_normal()}),
        ("camera_extrinsics", "camera", {"x": 0.0005 * rng.standard_normal(), "y": 0.0005 * rng.standard_normal()}),
    ]
    arm = [
        ("coulomb_friction", joint, {"level": 0.1 * rng.standard_normal() * friction})
        for joint, friction in zip(NOMINAL.joints, NOMINAL.frictionloss.tolist())
    ]
    usual = ((e, c, {k: float(f"{v:.9g}") for k, v in p.items()}) for e, c, p in (*scene, *arm) if e != kind)
    return Case(number, kind, gap, tuple(usual))


def make_key(count: int, seed: int) -> str:
    """The key as JSON text."""
    cases = [{"case": c.number, **{k: v for k, v in asdict(c).items() if k != "number"}} for c in draw(count, seed)]
    return json.dumps({"schema": SCHEMA, "set": SET, "seed": seed, "cases": cases}, indent=1, sort_keys=True) + "\n"


class Detector:
    """Errors of a detector of its own: first-order memory of the image before, now and then a corner that is wrong; and a camera that is
    knocked once. noise, gross: px, and share of corners; knocked: rad to the side from KNOCKED_AT on."""

    def __init__(self, seed: int, noise: float, gross: float, knocked: float = 0.0, focal: float = 1.0):
        self._rng = np.random.default_rng([seed, 7])
        self._noise, self._gross, self._shift = noise, gross, focal * float(np.tan(knocked))
        self._left = np.zeros((8, 2))

    def __call__(self, time: float, pixels: np.ndarray) -> np.ndarray:
        """Pixels (8, 2) as they are found at a time s."""
        new = np.sqrt(1 - MEMORY**2) * self._noise * self._rng.standard_normal((8, 2))
        self._left = MEMORY * self._left + new
        wrong = self._rng.random((8, 1)) < self._gross
        shift = np.array([self._shift * (time > KNOCKED_AT), 0.0])
        return pixels + self._left + shift + wrong * GROSS * self._rng.standard_normal((8, 2))
