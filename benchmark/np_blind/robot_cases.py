"""Withheld robots: a domain, and one or two effects of camera, timing, arm, contact or object that cost success in PhysX.

What may be drawn follows from (robots, seed) alone. How large the effects are is found by playing (`robot_sizes`): so the key is a file, whose
hash is put down before a doctor sees a recording of any of them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from np_blind.sealed import SCHEMA
from np_description.panda import JOINT_NAMES
from np_effects.patch import Patch, PatchEffect

SET = "robots"
DOMAINS = ("wall", "bump")
LOSS = (0.10, 0.40)  # of success, that a robot shall lose
Draw = Callable[[np.random.Generator], Callable[[float], PatchEffect]]
"""Draws what of an effect is not its size; the effect with a size from 0, nothing, to 1, as much as is tried."""


def _to_the_side(rng: np.random.Generator) -> Callable[[float], PatchEffect]:
    way = rng.uniform(0, 2 * np.pi)
    return lambda size: PatchEffect(
        "camera_extrinsics",
        "camera",
        {"x": round(0.03 * size * np.cos(way), 5), "y": round(0.03 * size * np.sin(way), 5)},
    )


def _of_arm(effect: str, parameter: str, most: float) -> Draw:
    """An effect of the whole arm, or of camera and so on, with one number that is positive."""
    return lambda rng: lambda size: PatchEffect(effect, "arm", {parameter: round(most * size, 5)})


def _at_joint(effect: str, parameter: str, most: Mapping[int, float], is_signed: bool = False) -> Draw:
    """An effect at one of some joints (1 to 7). most: of each."""

    def draw(rng: np.random.Generator) -> Callable[[float], PatchEffect]:
        joint = int(rng.choice(list(most)))
        sign = float(rng.choice([-1.0, 1.0])) if is_signed else 1.0
        return lambda size: PatchEffect(
            effect, JOINT_NAMES[joint - 1], {parameter: round(sign * most[joint] * size, 5)}
        )

    return draw


def _share(effect: str, part: str, low: float, high: float) -> Draw:
    """A share of a number, less of it (to `low`) or more (to `high`), 0 where it is not changed that way."""

    def draw(rng: np.random.Generator) -> Callable[[float], PatchEffect]:
        most = float(rng.choice([end for end in (low, high) if end]))
        return lambda size: PatchEffect(effect, part, {"relative": round(most * size, 4)})

    return draw


EFFECTS: dict[str, tuple[Draw, ...]] = {
    "camera": (_to_the_side,),
    "timing": (
        lambda rng: lambda size: PatchEffect("camera_latency", "camera", {"delay": round(0.3 * size, 4)}),
        _of_arm("command_delay", "delay", 0.06),
    ),
    "arm": (
        _at_joint("coulomb_friction", "level", {2: 12.0, 4: 12.0, 6: 4.0}),
        _at_joint("torque_offset", "offset", {2: 20.0, 4: 15.0, 6: 5.0}, is_signed=True),
        _at_joint("encoder_bias", "bias", {1: 0.04, 2: 0.04, 4: 0.04}, is_signed=True),
        _of_arm("payload", "mass", 3.0),
    ),
    "contact": (_share("gripper_friction", "contact", -0.9, 0.0), _share("table_friction", "contact", -0.8, 2.0)),
    "object": (_share("object_mass", "object", 0.0, 4.0),),
}
"""By what they belong to. A lens, blur and dropped frames are no part: training has no images. A table at another height neither, on which
training draws its tasks."""
ORDER = (
    "camera", "timing", "arm", "contact", "object", "camera arm", "timing contact", "arm", "contact camera", "arm timing",
    "arm contact", "camera object",
)  # fmt: skip
"""What is other about the robots of a set, over and over."""


@dataclass(frozen=True)
class Robot:
    """number; domain; effects, as entries of a patch.yaml; loss: of success in PhysX when its size was found, in points of 1, of `played`
    pairs of episodes."""

    number: int
    domain: str
    effects: tuple[PatchEffect, ...]
    loss: float
    played: int

    @property
    def patch(self) -> Patch:
        """What it is, truly."""
        return Patch(self.effects)

    @property
    def folder(self) -> str:
        """Of all that is its own."""
        return f"robot_{self.number:02d}"


def drawn(number: int, seed: int, attempt: int) -> tuple[str, Callable[[float], Patch]]:
    """Domain of a robot, and the robot with effects of a size: what is drawn at the first attempt, or at a later one. After two attempts it is
    of another kind."""
    rng = np.random.default_rng([seed, number, attempt])
    kinds = ORDER[(number + attempt // 2) % len(ORDER)].split()
    effects = [EFFECTS[kind][int(rng.integers(len(EFFECTS[kind])))](rng) for kind in kinds]
    scale = rng.uniform(0.6, 1.0, len(effects)) / (1.0 if len(effects) == 1 else 1.2)
    if len(effects) == 1:
        scale[:] = 1.0
    # The task suite is made for the bump's cube, and so is what it tells of an object's mass.
    domain = DOMAINS[1] if "object" in kinds else DOMAINS[number % len(DOMAINS)]
    return domain, lambda size: Patch(tuple(e(size * s) for e, s in zip(effects, scale)))


def make_key(robots: list[Robot], seed: int) -> str:
    """The key as JSON text."""
    cases = [{"case": r.number, **{k: v for k, v in asdict(r).items() if k != "number"}} for r in robots]
    return json.dumps({"schema": SCHEMA, "set": SET, "seed": seed, "cases": cases}, indent=1, sort_keys=True) + "\n"


def read_key(path: Path) -> list[Robot]:
    """The robots of a key. Raises OSError where it is not there."""
    return [
        Robot(c["case"], c["domain"], tuple(PatchEffect(**e) for e in c["effects"]), c["loss"], c["played"])
        for c in json.loads(path.read_text(encoding="utf-8"))["cases"]
    ]
