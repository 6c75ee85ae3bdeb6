"""The shapes of the Franka hand that touch: fingertips, the fingers' shafts, the housing.

Frames: of the hand, z towards the fingertips, fingers open along y; of a finger, y away from the other finger, which it meets
at y = 0.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BoxShape:
    """A box along the axes of its body's frame."""

    centre: tuple[float, float, float]
    """(3,) m."""
    half_size: tuple[float, float, float]
    """(3,) m."""


@dataclass(frozen=True)
class CapsuleShape:
    """A capsule in its body's frame."""

    centre: tuple[float, float, float]
    """(3,) m."""
    half_axis: tuple[float, float, float]
    """From the centre to the middle of one end's sphere (3,) m."""
    radius: float
    """m."""


Shape = BoxShape | CapsuleShape


@dataclass(frozen=True)
class HandShapes:
    """The hand's shapes that touch."""

    tip: Shape
    """Rubber tip of a finger."""
    tip_width: float
    """Half width of the tip along x that may meet a point, m."""
    shaft: Shape
    """The rest of the finger, without rubber."""
    housing: tuple[Shape, ...]
    """The hand's body."""

    @property
    def finger(self) -> tuple[Shape, ...]:
        """Both parts of a finger."""
        return self.shaft, self.tip


ROUND_HAND = HandShapes(
    tip=CapsuleShape((0.0, 0.0085, 0.0458), (0.0065, 0.0, 0.0), 0.008),
    tip_width=0.0065,
    shaft=CapsuleShape((0.0, 0.0095, 0.020), (0.0, 0.0, 0.016), 0.009),
    housing=(CapsuleShape((0.0, 0.0, 0.033), (0.0, 0.07, 0.0), 0.033),),
)
"""Capsules that enclose the parts: fingertips that can roll, and a housing 13 mm thicker than it is."""

FLAT_HAND = HandShapes(
    tip=BoxShape((0.0, 0.0072, 0.0450), (0.0087, 0.0072, 0.00885)),  # y from 0 to 14.4 mm, z from 36.2 to 53.85
    tip_width=0.0087,
    shaft=CapsuleShape((0.0, 0.0135, 0.0215), (0.0, -0.005, 0.0145), 0.0085),  # slants from the slide to the pad
    housing=(
        BoxShape((0.0, 0.0, 0.0385), (0.0205, 0.1005, 0.0275)),  # to z 66 mm, where the fingers come out
        BoxShape((0.0, 0.0, -0.0065), (0.0316, 0.0950, 0.0175)),  # the thicker half, towards the arm
    ),
)
"""Flat pads, and a housing in two steps.

Sizes are read off the convex collision meshes of the Panda's hand and finger (package example-robot-data 6.0.0,
panda_description); franka_description's boxes agree with them within 1 mm.
"""
