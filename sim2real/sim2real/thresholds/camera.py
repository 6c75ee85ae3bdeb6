"""Thresholds of the camera stage: seen corners against camera, lens, table and object (`sim2real.task.camera`)."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from typing import Any

from sim2real.thresholds.entry import JUDGEMENT, NUMERICS, threshold

USUAL = "anything within the bounds of every set-up: 1 mm and .1 degree of the camera, 1 mm of size"


def spreads(usual: float, gap: float, unit: str, meaning: str, source: str) -> Any:
    """Two standard deviations: usual, of a set-up that is well; gap, of one that is not."""
    return threshold((usual, gap), unit, f"{meaning}: usual, of a gap", source)


@dataclass(frozen=True)
class RestPoses:
    """Where the object rested, and which of these places count (`sim2real.task.camera.rest_poses`)."""

    same: float = threshold(2.0, "px", "by which a corner moves, in the middle, from one place to another", JUDGEMENT)
    corners: int = threshold(5, "corners", "fewest usable of a place", "the pose takes three numbers of ten")
    images: float = threshold(0.5, "1", "share of the images of a rest in which a corner must be usable", JUDGEMENT)
    memory: float = threshold(0.9, "1", "of a corner's scatter from image to image", "the released detector, at rest")
    margin: float = threshold(
        0.02, "m", "to either side of an obstacle's edge, where the object may lie on it or beside it", JUDGEMENT
    )
    lean: float = threshold(radians(5.0), "rad", "tilt from which a measured pose does not lie flat", JUDGEMENT)
    lifted: float = threshold(0.04, "m", "over a surface at which a measured pose does not lie on it", JUDGEMENT)
    off: float = threshold(
        6.0, "px", "root mean square from which corners are of no object that lies flat", "a camera 3 degrees off: 2 px"
    )


@dataclass(frozen=True)
class CameraSpreads:
    """Prior standard deviations of the camera model (`sim2real.task.camera.model`)."""

    shift: tuple[float, float] = spreads(0.0006, 0.01, "m", "camera's place, each axis", f"{USUAL}; public: 4 to 29 mm")
    turn: tuple[float, float] = spreads(
        radians(0.06), radians(1.0), "rad", "camera's turn, each axis", f"{USUAL}; public: 1.3 to 3 degrees"
    )
    focal: tuple[float, float] = spreads(0.0006, 0.01, "1", "focal length, relative", "0.5 to 2 %")
    offset: tuple[float, float] = spreads(0.2, 3.0, "px", "image's centre, or corners found to one side", "2 to 8 px")
    k1: tuple[float, float] = spreads(0.006, 0.1, "1", "radial distortion", "1 to 8 px at the border; .04 is 1 px")
    height: tuple[float, float] = spreads(0.0003, 0.005, "m", "table's height", "users report 10 to 20 mm")
    tilt: tuple[float, float] = spreads(radians(0.03), radians(0.3), "rad", "table's tilt, each axis", ".1 to 1 degree")
    size: tuple[float, float] = spreads(0.0006, 0.002, "m", "edge of the object, each", f"{USUAL}; 1 to 3 mm")
    measured: tuple[float, float] = threshold(
        (0.001, radians(0.3)), "m, rad", "standard deviations of a pose measured apart, each axis", JUDGEMENT
    )


@dataclass(frozen=True)
class CameraFitting:
    """Seen corners beside the model (`sim2real.task.camera.fit`)."""

    tails: float = threshold(4.0, "1", "degrees of freedom of a corner's error, Student's", "engineering judgement")
    first_tails: float = threshold(100.0, "1", "the same where the search begins", "engineering judgement")
    scatter: tuple[float, float] = threshold(
        (0.5, 1.0), "px, 1", "a detector's error of a corner in a view, and spread of its log", "released: .2 to .4 px"
    )
    scatters: tuple[float, float] = threshold((0.02, 30.0), "px", "least and most of it that is looked for", NUMERICS)
    steps: int = threshold(40, "steps", "most of Gauss, Newton and Levenberg", NUMERICS)
    settled: float = threshold(1e-5, "nats", "gain of a step at which a search ends", NUMERICS)
    rounds: int = threshold(5, "rounds", "of alternation between numbers and scatter", NUMERICS)
    damping: tuple[float, float] = threshold((1e-6, 10.0), "1", "Levenberg's first, and factor of it", NUMERICS)


@dataclass(frozen=True)
class CameraComparison:
    """Which hypothesis explains the seen corners (`sim2real.task.camera.diagnosis`)."""

    places: int = threshold(3, "places", "fewest that tell anything apart", JUDGEMENT)
    apart: float = threshold(40.0, "px", "between the two that are farthest apart, at least", "a fifth of the image")
    distant: float = threshold(
        8.0, "nats", "by which a fit is less probable, that no longer counts in a size", NUMERICS
    )
    most: int = threshold(3, "effects", "that are named at once", JUDGEMENT)
    misfit: float = threshold(
        2.0, "px", "of scatter that is left, beyond which it is unexplained", "2 px of a detector are usual"
    )
    strain: float = threshold(
        4.0, "1", "usual standard deviations by which a number may be off unnamed", "engineering judgement"
    )
    sure: float = threshold(
        1e-4, "1", "probability by chance below which a pattern counts", "corners are gross together now and then"
    )
    matters: float = threshold(0.3, "px", "root mean square of such a pattern that matters", ".6 mm on the table")
    cut: float = threshold(3.0, "1", "times its scatter to which a corner's error is cut in such patterns", JUDGEMENT)
    flat: float = threshold(0.5, "1", "share of the places at which the object must lie flat", JUDGEMENT)
    blind: float = threshold(
        0.35, "1", "share of the numbers beyond which, unseen, nobody can say that nothing is off", JUDGEMENT
    )
    narrowed: float = threshold(
        0.25, "1", "of a gap's interval to which a recording must narrow it to see it", JUDGEMENT
    )
    folds: int = threshold(8, "folds", "most, of places held out", NUMERICS)
