"""Withheld robots: a domain, and one or two effects of camera, timing, arm, contact or object that cost success in PhysX.

What may be drawn follows from (robots, seed) alone. How large the effects are is found by playing (`robots.sizes`): so the key is a file, whose
hash is committed before the diagnosis gets a recording of any of them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from sim2real.effects.patch import Patch, PatchEffect

from np_blind.sealed import SCHEMA
from np_description.panda import JOINT_NAMES

SET = "robots"
DOMAINS = ("wall", "bump")
LOSS = (0.10, 0.40)  # of success, that a robot shall lose
Draw = Callable[[np.random.Generator, str], Callable[[float], PatchEffect]]
"""Draws what of an effect in a domain is not its size; the effect with a size from 0, nothing, to 1, as much as is tried."""
MOST = 2.5  # times an edge is tried at most


def _to_the_side(edge: Mapping[str, float]) -> Draw:
    def draw(rng: np.random.Generator, domain: str) -> Callable[[float], PatchEffect]:
        way = rng.uniform(0, 2 * np.pi)
        most = MOST * edge[domain] * np.array([np.cos(way), np.sin(way)])
        return lambda size: PatchEffect(
            "camera_extrinsics", "camera", {axis: round(size * most[i], 5) for i, axis in enumerate("xy")}
        )

    return draw


def _positive(effect: str, component: str, parameter: str, edge: Mapping[str, float]) -> Draw:
    """An effect with one number that is positive."""
    return lambda rng, domain: (
        lambda size: PatchEffect(effect, component, {parameter: round(MOST * edge[domain] * size, 5)})
    )


def _at_joint(effect: str, parameter: str, edges: Mapping[str, Mapping[int, float]], is_signed: bool = False) -> Draw:
    """An effect at one of some joints (1 to 7). edges: of each."""

    def draw(rng: np.random.Generator, domain: str) -> Callable[[float], PatchEffect]:
        joint = int(rng.choice(list(edges[domain])))
        sign = float(rng.choice([-1.0, 1.0])) if is_signed else 1.0
        most = sign * MOST * edges[domain][joint]
        return lambda size: PatchEffect(effect, JOINT_NAMES[joint - 1], {parameter: round(most * size, 5)})

    return draw


def _share(effect: str, part: str, edges: Mapping[str, tuple[float, ...]], least: float = -0.9) -> Draw:
    """A share of a number, less of it, down to `least`, or more."""

    def draw(rng: np.random.Generator, domain: str) -> Callable[[float], PatchEffect]:
        most = MOST * float(rng.choice(edges[domain]))
        return lambda size: PatchEffect(effect, part, {"relative": round(max(most * size, least), 4)})

    return draw


EFFECTS: dict[str, tuple[Draw, ...]] = {
    "camera": (_to_the_side({"wall": 0.0105, "bump": 0.0045}),),
    "timing": (
        _positive("camera_latency", "camera", "delay", {"wall": 0.1, "bump": 0.075}),
        _positive("command_delay", "arm", "delay", {"wall": 0.0048, "bump": 0.0068}),
    ),
    "arm": (
        _at_joint("coulomb_friction", "level", {"wall": {2: 5.0, 4: 4.0, 6: 1.5}, "bump": {2: 4.0, 4: 3.0, 6: 1.0}}),
        _at_joint(
            "torque_offset", "offset", {"wall": {2: 7.4, 4: 5.0, 6: 1.5}, "bump": {2: 4.0, 4: 3.0, 6: 0.95}}, True
        ),
        _at_joint("encoder_bias", "bias", {"wall": {2: 0.014, 4: 0.014}, "bump": {2: 0.008, 4: 0.0055}}, True),
        _positive("payload", "arm", "mass", {"wall": 0.8, "bump": 0.8}),
    ),
    "contact": (
        _share("gripper_friction", "contact", {"wall": (-0.5,), "bump": (-0.55,)}),
        _share("table_friction", "contact", {"wall": (-0.4, 0.6), "bump": (-0.4, 0.6)}, -0.8),
    ),
    "object": (_share("object_mass", "object", {"bump": (1.6,)}),),
}
"""By what they belong to. The numbers are edges: sizes at which an effect alone costs about a quarter of success in PhysX, as sets 31 and 32 had
it, else by their likes: from there a robot's own size is looked for. A lens, blur and dropped frames are no part: training has no images. A table
at another height neither, on which training draws its tasks. Joint 1's zero costs nothing up to 40 mrad, nor does an object of five times the mass
by itself."""
ORDER = (
    "camera", "timing", "arm", "contact", "contact object", "camera arm", "timing contact", "arm", "contact camera", "arm timing",
    "arm contact", "camera object",
)  # fmt: skip
"""What is other about the robots of a set, over and over."""


@dataclass(frozen=True)
class Robot:
    """A withheld robot."""

    number: int
    """Number in the set."""
    domain: str
    """Task."""
    effects: tuple[PatchEffect, ...]
    """True effects, as entries of a patch.yaml."""
    loss: float
    """Loss of success in PhysX when its effect sizes were found."""
    played: int
    """Pairs of episodes by which the loss was measured."""

    @property
    def patch(self) -> Patch:
        """What it is, truly."""
        return Patch(self.effects)

    @property
    def folder(self) -> str:
        """Of all that is its own."""
        return f"robot_{self.number:02d}"


def draw_robot(number: int, seed: int, attempt: int) -> tuple[str, Callable[[float], Patch]]:
    """Domain of a robot, and the robot with effects of a size: what is drawn at the first attempt, or at a later one. After two attempts it is
    of another kind."""
    rng = np.random.default_rng([seed, number, attempt])
    kinds = ORDER[(number + attempt // 2) % len(ORDER)].split()
    # The task suite is made for the bump's cube, and so is its estimate of an object's mass.
    domain = DOMAINS[1] if "object" in kinds else DOMAINS[number % len(DOMAINS)]
    effects = [EFFECTS[kind][int(rng.integers(len(EFFECTS[kind])))](rng, domain) for kind in kinds]
    scale = rng.uniform(0.6, 1.0, len(effects)) / (1.0 if len(effects) == 1 else 1.2)
    if len(effects) == 1:
        scale[:] = 1.0
    return domain, lambda size: Patch(tuple(e(size * s) for e, s in zip(effects, scale.tolist())))


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
