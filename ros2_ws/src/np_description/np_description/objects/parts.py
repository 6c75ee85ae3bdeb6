"""An object as bodies: a core that the camera sees, and parts that slide on it, each along one axis.

Soft faces are plates on springs, contents a chain of carriages with friction. Mass, centre of mass and inertia of the whole are
the object's with every part in its middle position; the core has what the parts leave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_description.objects.spec import ObjectSpec

GRAVITY = 9.81  # m/s^2
AXES = "xyz"
PLATE_SHARE = 0.02  # of the mass, each of six
PLATE_RATE = 150.0  # rad/s of a plate on its spring: .3 a step of 2 ms, which an explicit spring bears
CARRIAGE_SHARE = 0.05  # of the contents' mass, where they slide along several axes


@dataclass(frozen=True)
class SlidingPart:
    """A homogeneous box that slides along one axis of the object."""

    name: str
    """Of its body in the scene."""
    axis: int
    """0, 1 or 2."""
    mass: float
    """kg."""
    centre: np.ndarray
    """Its place at rest in the object's frame (3,) m."""
    half_size: np.ndarray
    """(3,) m."""
    travel: tuple[float, float]
    """From, to, m."""
    parent: str | None = None
    """The part that carries it; None: the core."""
    touches: bool = False
    """Whether it is part of the object's outside."""
    stiffness: float = 0.0
    """Of its spring, N/m."""
    damping: float = 0.0
    """Of its spring, N s/m."""
    armature: float = 0.0
    """Inertia of the drive, which has no weight and slows the spring, kg."""
    friction: float = 0.0
    """N."""

    @property
    def spread(self) -> np.ndarray:
        """Second moments of mass (3, 3) kg m^2 about its own centre."""
        return np.diag(self.mass / 3 * self.half_size**2)


@dataclass(frozen=True)
class Core:
    """The body that carries the sliding parts."""

    mass: float
    """kg."""
    centre: np.ndarray
    """Centre of mass (3,) m."""
    inertia: np.ndarray
    """About the centre of mass (3, 3) kg m^2."""


def split_object(spec: ObjectSpec) -> tuple[Core, tuple[SlidingPart, ...]]:
    """Core and parts of an object; a rigid one is all core. Raises ValueError where the parts weigh too far out for its inertia."""
    parts = (*_plates(spec), *_carriages(spec))
    centre, moments = np.asarray(spec.centre_of_mass, float), np.asarray(spec.moments, float)
    mass = spec.mass - sum(part.mass for part in parts)
    own = spec.mass * centre - sum((part.mass * part.centre for part in parts), np.zeros(3))
    own /= mass  # the core's
    spread = np.diag(moments.sum() / 2 - moments) + spec.mass * np.outer(centre, centre) - mass * np.outer(own, own)
    for part in parts:
        spread -= part.spread + part.mass * np.outer(part.centre, part.centre)
    if np.linalg.eigvalsh(spread)[0] < -1e-9 * np.trace(spread):
        raise ValueError(
            f"inertia: expected room for the moving parts of {spec.name}, whose own inertia is larger along an axis; "
            f"got {list(spec.moments)} kg m^2"
        )
    return Core(mass, own, np.trace(spread) * np.eye(3) - spread), parts


def _plates(spec: ObjectSpec) -> list[SlidingPart]:
    """One on each face, proud of the core by its travel and as thick as it can be: what is thin is pressed through."""
    if spec.compliance is None:
        return []
    half, travel, plates = np.asarray(spec.half_size), spec.compliance.travel, []
    for axis in range(3):
        # Two plates in a row have half the stiffness of one. That of foam: by area over length, relative to z.
        share = (half[(axis + 1) % 3] * half[(axis + 2) % 3] / half[axis]) / (half[0] * half[1] / half[2])
        stiffness = 2 * spec.compliance.stiffness * share
        size = half - travel
        size[axis] = half[axis] / 2
        for sign, side in ((1, "upper"), (-1, "lower")):
            centre = np.zeros(3)
            centre[axis] = sign * half[axis] / 2
            plates.append(
                SlidingPart(
                    f"{side}_{AXES[axis]}",
                    axis,
                    PLATE_SHARE * spec.mass,
                    centre,
                    size,
                    (-travel, 0.0) if sign > 0 else (0.0, travel),
                    touches=True,
                    stiffness=stiffness,
                    damping=2 * stiffness / PLATE_RATE,  # critical
                    armature=stiffness / PLATE_RATE**2,
                )
            )
    return plates


def _carriages(spec: ObjectSpec) -> list[SlidingPart]:
    """A chain of one for each axis that the contents may slide along; the last is the contents."""
    contents = spec.contents
    if contents is None:
        return []
    axes = [axis for axis in range(3) if contents.clearance[axis] > 0]
    size, chain, parent = np.asarray(spec.half_size) - np.asarray(contents.clearance), [], None
    for number, axis in enumerate(axes):
        is_last = number == len(axes) - 1
        mass = contents.mass * (1 - CARRIAGE_SHARE * (len(axes) - 1) if is_last else CARRIAGE_SHARE)
        gap, friction = contents.clearance[axis], contents.friction * contents.mass * GRAVITY
        chain.append(
            SlidingPart(
                f"inside_{AXES[axis]}", axis, mass, np.zeros(3), size, (-gap, gap), parent=parent, friction=friction
            )
        )
        parent = chain[-1].name
    return chain
