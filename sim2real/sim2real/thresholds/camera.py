"""Thresholds of the camera stage: corners against camera, lens, table and object (`sim2real.task.camera`).

A pair of spreads holds two standard deviations: of a correct set-up, and of one with a gap. A correct set-up is within the
bounds of every set-up: 1 mm and 0.1 degree of the camera, 1 mm of the object's size.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians


@dataclass(frozen=True)
class RestPoses:
    """Where the object rested, and which places count (`sim2real.task.camera.rest_poses`)."""

    same: float = 2.0
    """px, median displacement of the corners from one place to another."""
    corners: int = 5
    """Smallest number of usable corners: a pose takes three numbers of ten."""
    images: float = 0.5
    """Smallest share of the images of a rest in which a corner is usable."""
    memory: float = 0.9
    """Memory of a corner's scatter from image to image: the released detector at rest."""
    margin: float = 0.02
    """m on either side of an obstacle's edge where the object may lie on it or beside it."""
    lean: float = radians(5.0)
    """rad, tilt from which a measured pose does not lie flat."""
    lifted: float = 0.04
    """m above a surface from which a measured pose does not lie on it."""
    off: float = 6.0
    """px RMS from which corners belong to no flat object; a camera that is turned by 3 degrees gives 2 px."""


@dataclass(frozen=True)
class CameraSpreads:
    """Prior standard deviations of the camera model (`sim2real.task.camera.model`): correct set-up, gap."""

    shift: tuple[float, float] = (0.0006, 0.01)
    """m, camera position, each axis; published: 4 to 29 mm."""
    turn: tuple[float, float] = (radians(0.06), radians(1.0))
    """rad, camera orientation, each axis; published: 1.3 to 3 degrees."""
    focal: tuple[float, float] = (0.0006, 0.01)
    """Relative focal length; published: 0.5 to 2 %."""
    offset: tuple[float, float] = (0.2, 3.0)
    """px, principal point or a common offset of the corners; published: 2 to 8 px."""
    k1: tuple[float, float] = (0.006, 0.1)
    """Radial distortion: 1 to 8 px at the border; 0.04 is 1 px."""
    height: tuple[float, float] = (0.0003, 0.005)
    """m, table height; users report 10 to 20 mm."""
    tilt: tuple[float, float] = (radians(0.03), radians(0.3))
    """rad, table tilt, each axis; 0.1 to 1 degree."""
    size: tuple[float, float] = (0.0006, 0.002)
    """m, each edge of the object; 1 to 3 mm."""
    measured: tuple[float, float] = (0.001, radians(0.3))
    """m and rad, standard deviations of a pose that was measured separately, each axis."""


@dataclass(frozen=True)
class CameraFitting:
    """The fit of corners by the camera model (`sim2real.task.camera.fit`)."""

    tails: float = 4.0
    """Degrees of freedom of Student's t distribution of a corner's error."""
    first_tails: float = 100.0
    """The same at the start of the search."""
    scatter: tuple[float, float] = (0.5, 1.0)
    """px, a detector's error of a corner, and spread of its logarithm; released: 0.2 to 0.4 px."""
    scatters: tuple[float, float] = (0.02, 30.0)
    """px, bounds of that error."""
    steps: int = 40
    """Largest number of Levenberg-Marquardt steps."""
    settled: float = 1e-5
    """nats, gain of a step at which the search ends."""
    rounds: int = 5
    """Alternations between parameters and scatter."""
    damping: tuple[float, float] = (1e-6, 10.0)
    """First damping of Levenberg and Marquardt, and the factor of its changes."""


@dataclass(frozen=True)
class CameraComparison:
    """Which hypothesis explains the corners (`sim2real.task.camera.diagnosis`)."""

    places: int = 3
    """Smallest number of places."""
    apart: float = 40.0
    """px between the two places that are farthest apart, at least: a fifth of the image."""
    distant: float = 8.0
    """nats by which a fit may be less probable and still count in an estimate."""
    most: int = 3
    """Largest number of effects in one hypothesis."""
    misfit: float = 2.0
    """px of remaining scatter from which the corners are unexplained; 2 px of a detector are usual."""
    strain: float = 4.0
    """Usual standard deviations by which a parameter that is not reported may be off."""
    sure: float = 1e-4
    """Probability by chance below which a pattern counts: corners have gross errors together now and then."""
    matters: float = 0.3
    """px RMS of a pattern that matters: 0.6 mm on the table."""
    cut: float = 3.0
    """Multiple of the scatter at which a corner's error is clipped in such patterns."""
    flat: float = 0.5
    """Smallest share of the places at which the object lies flat."""
    blind: float = 0.35
    """Largest share of the parameters that may be unidentifiable before the verdict is undetermined."""
    narrowed: float = 0.25
    """Share of a gap's interval to which a recording must narrow a parameter to identify it."""
    folds: int = 8
    """Largest number of folds of held-out places."""
