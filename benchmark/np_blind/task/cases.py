"""Cases of the task set: the task suite in PhysX, with a background that is always on, and a gap or none.

The key is a function of (cases, seed) alone and needs no simulation.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from math import radians

import numpy as np
from sim2real.effects import CAMERA_EFFECTS, SCENE_EFFECTS
from sim2real.effects.patch import Patch, PatchEffect

from np_blind.camera import quirks
from np_blind.camera.quirks import Quirks
from np_blind.camera.simulated_camera import DistortedCamera, UnknownCameraFaults
from np_blind.sealed import SCHEMA
from np_description.domains import BUMP, Task
from np_description.panda import NOMINAL

SET = "task"
OUT = "out"
EFFECTS = {**SCENE_EFFECTS, **CAMERA_EFFECTS}
Gap = dict[str, float]


@dataclass(frozen=True)
class BackgroundSpread:
    """Standard deviations of the deviations that every case has."""

    mass: float = 0.01
    """Relative mass of the object."""
    friction: float = 0.03
    """Relative friction of the table."""
    table: float = 0.0002
    """Height m of the table."""
    place: float = 0.0005
    """Position m of the camera, each axis."""
    turn: float = 0.0006
    """Rotation rad of the camera, each axis."""
    joint: float = 0.1
    """Relative friction of a joint."""
    zero: float = 0.0003
    """Encoder zero rad of a joint."""
    edge: float = 0.0004
    """Edge m of the object, each."""


USUAL = BackgroundSpread()


@dataclass(frozen=True)
class TaskCase:
    """A set-up with a gap or none."""

    number: int
    """Number in the set."""
    kind: str
    """clean, single, pair (of effects of the catalogue) or out (of the catalogue)."""
    gap: dict[str, Gap] = field(default_factory=dict)
    """Parameters by effect, or by what is out of the catalogue."""
    usual: tuple[tuple[str, str, Gap], ...] = ()
    """Background: effect, component and parameters."""
    longer: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Excess m of the object's edges over the nominal ones."""
    camera: Quirks = Quirks()
    """Properties of a camera and detector without a gap."""

    @property
    def domain(self) -> Task:
        """The bump's, whose cube is of its true size, and weighs what it weighs."""
        half = tuple(h + edge / 2 for h, edge in zip(BUMP.half_size, self.longer))
        return replace(BUMP, half_size=half, density=BUMP.density * float(np.prod(BUMP.half_size) / np.prod(half)))

    @property
    def effects(self) -> tuple[str, ...]:
        """Those of the catalogue that the gap is made of."""
        return tuple(name for name in self.gap if name in EFFECTS)

    @property
    def patch(self) -> Patch:
        """The deviations from nominal, without those outside the catalogue."""
        own = [PatchEffect(name, str(EFFECTS[name].target), self.gap[name]) for name in self.effects]
        return Patch((*own, *(PatchEffect(*one) for one in self.usual)))

    def stranger(self, name: str, quantity: str) -> float:
        """Of what is out of the catalogue, a quantity; 0 where it is not there."""
        return self.gap.get(name, {}).get(quantity, 0.0)

    def film(self, seed: int) -> DistortedCamera:
        """The camera of a recording with such a seed."""
        strange = UnknownCameraFaults(
            knocked=self.stranger("knocked", "turn"),
            at=self.stranger("knocked", "at"),
            breathing=self.stranger("breathing", "scale"),
            hunting=self.stranger("hunting", "period"),
            dark=self.stranger("hunting", "dark"),
        )
        return DistortedCamera(np.array(self.domain.half_size), self.camera, self.patch, seed, strange)


def _either(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.choice([-1.0, 1.0]) * rng.uniform(low, high))


def _elsewhere(rng: np.random.Generator) -> Gap:
    """A camera that is moved, or turned, to the side."""
    way, size = rng.uniform(0, 2 * np.pi), rng.uniform(3, 8)
    if rng.random() < 0.5:
        return {"x": size * 0.002 * float(np.cos(way)), "y": size * 0.002 * float(np.sin(way))}
    return {"turn_x": size * radians(0.2) * float(np.cos(way)), "turn_y": size * radians(0.2) * float(np.sin(way))}


GAPS: dict[str, Callable[[np.random.Generator], Gap]] = {
    "table_height": lambda rng: {"height": _either(rng, 0.003, 0.008)},
    "object_mass": lambda rng: {"relative": _either(rng, 0.3, 0.5)},
    "table_friction": lambda rng: {"relative": _either(rng, 0.24, 0.45)},
    "gripper_friction": lambda rng: {"relative": -float(rng.uniform(0.35, 0.6))},
    "camera_extrinsics": _elsewhere,
    "camera_latency": lambda rng: {"delay": float(rng.uniform(0.009, 0.06))},
    "keypoint_noise": lambda rng: {"spread": float(rng.uniform(1.5, 3.0)), "memory": float(rng.uniform(0.0, 0.8))},
    "keypoint_outliers": lambda rng: {"share": float(rng.uniform(0.03, 0.08)), "size": float(rng.uniform(8, 25))},
    "cable": lambda rng: {"pull": float(rng.uniform(0.25, 0.45)), "way": float(rng.uniform(-np.pi, np.pi))},
    "magnet": lambda rng: {
        "pull": float(rng.uniform(1.0, 2.5)),
        "x": float(rng.uniform(0.45, 0.55)),
        "y": -float(rng.uniform(0.1, 0.2)),  # where the object is: on the other side it would pull by .05 N
    },
    "knocked": lambda rng: {"turn": _either(rng, radians(0.5), radians(1.0)), "at": float(rng.uniform(40, 100))},
    "breathing": lambda rng: {"scale": float(rng.uniform(0.01, 0.02))},
    "hunting": lambda rng: {"period": float(rng.uniform(1.0, 3.0)), "dark": float(rng.uniform(3, 6))},
}
"""Of 3 to 8 times the limit of an effect, as far as a simulator takes it. cable: N, that pulls the object all the time, in a direction rad;
magnet: N, that pull the object down over a place of the table (m), and less with the distance; knocked: rad, by which the camera turns to the
side at a moment s; breathing: share, by which the picture grows and shrinks every 7 s, about its middle; hunting: s, in which exposure and gain go up
and down, and how many times noisier corners are in the darkest images, half of whose corners no policy would take."""
OUT_OF_CATALOGUE = ("cable", "magnet", "knocked", "breathing", "hunting")
CONFOUNDED = ("table_friction", "object_mass")
"""A pair that pushes hold as one product."""
ORDER = (
    "", "table_height", "camera_latency", "cable", "table_friction camera_latency", "object_mass", "camera_extrinsics", "",
    "table_friction", "gripper_friction", "table_height camera_extrinsics", "knocked", "keypoint_noise", "",
    "table_friction object_mass", "camera_latency", "object_mass", "magnet", "camera_extrinsics", "gripper_friction table_height",
    "", "table_friction", "keypoint_outliers", "breathing", "object_mass camera_latency", "table_height", "",
    "gripper_friction", "camera_extrinsics camera_latency", "hunting",
)  # fmt: skip
"""What is other in the cases of a set, over and over: any beginning of it has some of all kinds."""


def draw(count: int, seed: int) -> list[TaskCase]:
    """So many cases of a set."""
    return [_case(number, ORDER[number % len(ORDER)].split(), seed) for number in range(count)]


def _case(number: int, names: Sequence[str], seed: int) -> TaskCase:
    rng = np.random.default_rng([seed, number])
    gap = {name: _rounded(GAPS[name](rng)) for name in names}
    kind = OUT if set(names) & set(OUT_OF_CATALOGUE) else ("clean", "single", "pair")[len(names)]
    scene = [
        ("object_mass", "object", {"relative": USUAL.mass * rng.standard_normal()}),
        ("table_friction", "contact", {"relative": USUAL.friction * rng.standard_normal()}),
        ("table_height", "environment", {"height": USUAL.table * rng.standard_normal()}),
        (
            "camera_extrinsics",
            "camera",
            {axis: USUAL.place * rng.standard_normal() for axis in "xyz"}
            | {f"turn_{axis}": USUAL.turn * rng.standard_normal() for axis in "xyz"},
        ),
    ]
    arm = [
        (effect, joint, {name: size * rng.standard_normal()})
        for joint, friction in zip(NOMINAL.joints, NOMINAL.frictionloss.tolist())
        for effect, name, size in (
            ("coulomb_friction", "level", USUAL.joint * friction),
            ("encoder_bias", "bias", USUAL.zero),
        )
    ]
    usual = ((e, c, _rounded(p)) for e, c, p in (*scene, *arm) if e not in gap)
    longer = _rounded({axis: USUAL.edge * rng.standard_normal() for axis in "xyz"}).values()
    return TaskCase(number, kind, gap, tuple(usual), tuple(longer), quirks.draw(rng))


def _rounded(gap: Gap) -> Gap:
    """Nine digits: the last ones may differ between machines."""
    return {name: float(f"{value:.9g}") for name, value in gap.items()}


def make_key(count: int, seed: int) -> str:
    """The key as JSON text."""
    cases = [{"case": c.number, **{k: v for k, v in asdict(c).items() if k != "number"}} for c in draw(count, seed)]
    return json.dumps({"schema": SCHEMA, "set": SET, "seed": seed, "cases": cases}, indent=1, sort_keys=True) + "\n"
