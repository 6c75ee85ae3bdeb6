"""The numbers of a push as one vector: what is known of each beforehand, how it varies, and which effect changes it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim2real.task.limit_surface import Pushed
from sim2real.thresholds import THRESHOLDS

SPREADS = THRESHOLDS.push_spreads


@dataclass(frozen=True)
class Parameter:
    """One number of `Pushed`, as its logarithm where `is_log`, and standard deviations of it.

    field, element: of which field, and which of a pair. known: before any run of a set-up is seen. varies: from run to run of
    one set-up. change: of a gap, or of what is another when a session begins.
    """

    field: str
    element: int | None
    known: float
    varies: float
    change: float
    is_log: bool = False


def _pair(field: str, spreads: tuple[float, float, float]) -> tuple[Parameter, Parameter]:
    return Parameter(field, 0, *spreads), Parameter(field, 1, *spreads)


PARAMETERS: tuple[Parameter, ...] = (
    Parameter("friction", None, *SPREADS.friction, is_log=True),
    Parameter("support", None, *SPREADS.support, is_log=True),
    Parameter("tip_friction", None, *SPREADS.tip_friction, is_log=True),
    Parameter("half_side", None, *SPREADS.half_side),
    *_pair("centre", SPREADS.centre),
    *_pair("anisotropy", SPREADS.anisotropy),
    Parameter("speed", None, *SPREADS.speed),
    *_pair("place", SPREADS.place),
    *_pair("marker", SPREADS.marker),
    Parameter("heading", None, *SPREADS.heading),
    *_pair("registration", SPREADS.registration),
    Parameter("sensor_turn", None, *SPREADS.sensor_turn),
    *_pair("bias", SPREADS.bias),
)

# Effects by the field that they change. Ids that share a field cannot be told apart by slow pushes, and are named together.
EFFECTS: dict[tuple[str, ...], str] = {
    ("table_friction", "object_mass"): "friction",
    ("contact_patch", "torsional_friction"): "support",
    ("gripper_friction",): "tip_friction",
    ("object_size",): "half_side",
    ("object_com",): "centre",
    ("anisotropic_friction",): "anisotropy",
    ("velocity_dependent_friction",): "speed",
    ("patchy_friction",): "place",
}
# What is another when a session begins, and no gap: the tip is exchanged, the object's markers are, the sensor is zeroed.
NUISANCES = tuple(dict.fromkeys(p.field for p in PARAMETERS if p.field not in EFFECTS.values()))
SPLIT_BY: dict[tuple[str, ...], str] = {
    ("table_friction", "object_mass"): "taps, or slides without the tip: deceleration is mu g whatever the mass",
    ("contact_patch", "torsional_friction"): "none for a flat object",
    ("velocity_dependent_friction", "patchy_friction"): "the same push at three speeds",
    ("object_com", "anisotropic_friction", "patchy_friction"): "the object turned by 90 degrees, and moved elsewhere",
}


def numbers(field: str) -> np.ndarray:
    """Places of a field in the vector."""
    return np.array([n for n, p in enumerate(PARAMETERS) if p.field == field])


def to_vector(pushed: Pushed) -> np.ndarray:
    """Vector (d,) of PARAMETERS."""
    values = (
        getattr(pushed, p.field) if p.element is None else getattr(pushed, p.field)[p.element] for p in PARAMETERS
    )
    return np.array([np.log(v) if p.is_log else v for p, v in zip(PARAMETERS, values)])


def from_vector(vector: np.ndarray) -> Pushed:
    """What a vector (d,) says; of vectors (w, d), the numbers of each window."""
    fields: dict[str, np.ndarray | tuple[np.ndarray, ...]] = {}
    for p, value in zip(PARAMETERS, np.moveaxis(vector, -1, 0)):
        value = np.exp(value) if p.is_log else value
        fields[p.field] = value if p.element is None else (*fields.get(p.field, ()), value)
    return replace(Pushed(), **fields)
