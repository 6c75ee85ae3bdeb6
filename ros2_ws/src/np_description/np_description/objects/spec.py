"""One object: size, mass, surface, and what of it is not rigid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

SIZES, MASSES, FRICTIONS = (0.002, 0.3), (0.0005, 2.0), (0.1, 2.0)  # m, kg, Coulomb coefficients: from, to
STIFFNESSES, TRAVELS = (10.0, 1e6), (1e-4, 0.05)  # N/m, m


@dataclass(frozen=True)
class Friction:
    """A Coulomb coefficient with its source."""

    coefficient: float
    """Dimensionless."""
    source: str
    """A publication or a measurement."""

    def __post_init__(self):
        _check("friction", self.coefficient, FRICTIONS, "")


@dataclass(frozen=True)
class Surface:
    """The covering of an object."""

    name: str
    """As in object files."""
    finger: Friction
    """Friction with a rubber fingertip."""
    table: Friction
    """Friction with the table and the obstacles."""


@dataclass(frozen=True)
class Softness:
    """Compliance of an object's faces; other axes scale as a foam of their area over their length."""

    stiffness: float
    """Of the whole object, pressed flat between two plates along its z axis, N/m."""
    travel: float
    """Of one face, after which it is hard, m."""

    def __post_init__(self):
        _check("compliance.stiffness", self.stiffness, STIFFNESSES, "N/m")
        _check("compliance.travel", self.travel, TRAVELS, "m")


@dataclass(frozen=True)
class Contents:
    """A mass that slides inside an object."""

    mass: float
    """Part of the object's mass, kg."""
    clearance: tuple[float, float, float]
    """How far it slides either way along x, y, z (3,) m."""
    friction: float
    """Coulomb coefficient with the inside."""

    def __post_init__(self):
        _check("contents.mass", self.mass, MASSES, "kg")
        _check("contents.friction", self.friction, FRICTIONS, "")
        for gap in _vector("contents.clearance", self.clearance, "m"):
            if gap < 0:
                raise ValueError(f"contents.clearance: expected at least 0 m, got {gap:g}")


@dataclass(frozen=True)
class ObjectSpec:
    """A box-shaped object of a domain: origin in the middle, axes along the edges. Raises ValueError, one line, for values that no such object has."""

    name: str
    """As on command lines."""
    domain: str
    """Task family that it is moved in."""
    size: tuple[float, float, float]
    """Edges (3,) m."""
    mass: float
    """All of it, kg."""
    surface: Surface
    """Its covering."""
    centre_of_mass: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From the middle (3,) m."""
    inertia: tuple[float, float, float] | None = None
    """About the centre of mass, axes along the edges (3,) kg m^2; None: of a homogeneous box."""
    compliance: Softness | None = None
    """Of its faces; None: hard."""
    contents: Contents | None = None
    """What slides inside; None: nothing."""

    def __post_init__(self):
        for edge in _vector("size", self.size, "m"):
            _check("size", edge, SIZES, "m")
        _check("mass", self.mass, MASSES, "kg")
        for shift, half in zip(_vector("centre_of_mass", self.centre_of_mass, "m"), self.half_size):
            if abs(shift) >= half:
                raise ValueError(
                    f"centre_of_mass: expected a point inside the object, less than {half:g} m, got {shift:g}"
                )
        if self.inertia is not None:
            a, b, c = sorted(_vector("inertia", self.inertia, "kg m^2"))
            if a <= 0 or c > 1.000001 * (a + b):
                raise ValueError(
                    f"inertia: expected positive moments in kg m^2, none above the sum of the others, got {list(self.inertia)}"
                )
        if self.compliance and self.compliance.travel >= 0.5 * min(self.half_size):
            raise ValueError(
                f"compliance.travel: expected less than a quarter of the shortest edge, {0.5 * min(self.half_size):g} m, "
                f"got {self.compliance.travel:g}"
            )
        if self.contents:
            if self.contents.mass > 0.9 * self.mass:
                raise ValueError(
                    f"contents.mass: expected at most .9 of the object's {self.mass:g} kg, got {self.contents.mass:g}"
                )
            for gap, half in zip(self.contents.clearance, self.half_size):
                if gap > 0.8 * half:
                    raise ValueError(
                        f"contents.clearance: expected at most .8 of half an edge, {0.8 * half:g} m, got {gap:g}"
                    )

    @property
    def half_size(self) -> tuple[float, float, float]:
        """Half the edges, m."""
        return tuple(edge / 2 for edge in self.size)

    @property
    def moments(self) -> tuple[float, float, float]:
        """Moments of inertia (3,) kg m^2 about the centre of mass."""
        if self.inertia is not None:
            return self.inertia
        x, y, z = (edge * edge for edge in self.size)
        return tuple(self.mass / 12 * side for side in (y + z, x + z, x + y))

    @property
    def density(self) -> float:
        """Mean density, kg/m^3."""
        return self.mass / float(np.prod(self.size))

    @property
    def is_rigid(self) -> bool:
        """Whether it is one body."""
        return self.compliance is None and self.contents is None


def _check(name: str, value: float, limits: tuple[float, float], unit: str) -> None:
    number = isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value)
    if not number or not limits[0] <= value <= limits[1]:
        shown = f"{value:g}" if number else repr(value)
        raise ValueError(f"{name}: expected {limits[0]:g} to {limits[1]:g} {unit}".rstrip() + f", got {shown}")


def _vector(name: str, values: Sequence[float], unit: str) -> Sequence[float]:
    is_three = isinstance(values, Sequence) and not isinstance(values, str) and len(values) == 3
    if not is_three or not all(isinstance(v, (int, float)) and not isinstance(v, bool) and isfinite(v) for v in values):
        raise ValueError(f"{name}: expected three numbers in {unit}, got {values!r}")
    return values
