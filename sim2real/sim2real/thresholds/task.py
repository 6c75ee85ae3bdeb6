"""Thresholds of the stages that need the task suite; pairs of spreads as in `camera`."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians


@dataclass(frozen=True)
class TipForce:
    """Forces from joint torques (`sim2real.task.wrench`)."""

    rate: float = 50.0
    """Rows per second, each the mean of the states in between."""
    turned: float = 0.004
    """rad/s, speed from which a joint's friction has reversed."""
    torque: float = 0.03
    """Nm, error of a joint's torque beside friction: torque sensors of the Panda."""
    friction: float = 0.05
    """Share of a moving joint's friction that is unknown."""
    left: float = 0.2
    """Share of a joint's error that is left after its mean without contact is subtracted."""


@dataclass(frozen=True)
class SurfaceContact:
    """Surfaces that stopped the tip (`sim2real.task.surface`)."""

    least: float = 1.5
    """N, smallest contact force that is detected; joints at rest hide 0.7 N."""
    rows: int = 8
    """Smallest number of rows of contact for a line fit."""
    agreed: float = 0.002
    """m, largest distance of touched points from a plane."""
    angle: float = 0.0002
    """m, error of one touch by the joints' angles: 0.3 mrad of one joint."""
    common: float = 0.0002
    """m, common error of all touches: 0.3 mrad of all joints."""
    height: tuple[float, float] = (0.0003, 0.008)
    """m, table height; users report 10 to 20 mm."""
    tilt: tuple[float, float] = (radians(0.03), radians(0.4))
    """rad, table tilt, each axis; 0.1 to 1 degree."""
    size: tuple[float, float] = (0.0006, 0.002)
    """m, upright edge of the object."""


@dataclass(frozen=True)
class FrictionAndMass:
    """Friction and mass from forces of slow drags, pushes and scrapes (`sim2real.task.contact_force`)."""

    pressed: float = 0.8
    """N, smallest press of a drag that counts."""
    moving: float = 0.6
    """Share of its speed from which a stroke counts."""
    lifts: float = 0.006
    """m/s, largest vertical speed of a tip that moves along the table."""
    chatter: float = 0.0008
    """m/s, mean vertical speed from which the tip chatters (two engines)."""
    rows: int = 6
    """Smallest number of rows of a reading."""
    edge: int = 2
    """Rows left out at either end of a stroke."""
    memory: float = 4.0
    """Rows that count as one independent row."""
    clear: float = 0.001
    """m above its lowest point at which a scraping tip may touch the table."""
    slides: float = 0.006
    """m/s down a face from which the tip slides on it."""
    held: float = 2.0
    """N on a face from which a scrape counts."""
    force: float = 0.02
    """N, error of a mean force beside its scatter."""
    relative: float = 0.012
    """Relative error of such a force."""
    face: float = 0.5
    """Share of a push by which the tip's friction holds the face up or down."""
    follows: float = 0.8
    """Smallest share of a drag that the object follows; a hopping tip gives less."""
    slips: float = 0.3
    """The same share, up to which the tip slips over an object at rest (two engines)."""
    proportion: float = 0.15
    """Largest spread of the log ratios of slipping strokes; a hopping tip has more (two engines)."""
    surely: float = 1.2
    """Factor of the press from which a tip certainly moves the object (two engines, tips of 1.0 and 0.5)."""
    common: float = 0.018
    """N, error that drags, or pushes in one direction, have in common."""
    usually: float = 4.0
    """Readings that the usual errors count as, beside those of a recording."""
    law: tuple[float, float] = (0.0, 0.015)
    """Log ratio of slow sliding friction to the coefficient: mean, deviation (two engines: -1.5 to 0.2 %)."""
    table: tuple[float, float] = (0.04, 0.35)
    """Log friction with the table; 10 to 20 % between set-ups."""
    mass: tuple[float, float] = (0.015, 0.35)
    """Log mass; scales: 3 %."""
    finger: tuple[float, float] = (0.1, 0.5)
    """Log friction of the fingertip: rubber, worn or dusty."""
    turning: float = 0.04
    """Relative error of the force of a push that turns the object (two engines)."""
    central: float = 0.005
    """m from the object's centre within which a push does not turn it."""
    pull: float = 0.1
    """N, smallest force by which something else pulls the object."""
    apart: float = 0.05
    """m over which such a force may change by its unit."""
    pulled: float = 12.0
    """nats by which the forces are more probable with such a force."""
    misfit: float = 3.0
    """Ratio of what is left to the usual errors from which forces are unexplained."""


@dataclass(frozen=True)
class LatencyEstimate:
    """Images against the tip that pushes the object (`sim2real.task.suite.image_latency`)."""

    within: float = 0.3
    """s, largest delay that is estimated."""
    way: float = 0.0003
    """m, error of the object's path in one image: a tenth of a pixel, eight corners."""
    left: float = 0.0012
    """m RMS of a path's residual from which the object did not follow."""
    scale: float = 2.0
    """Per cent by which the object moves less than the tip: it turns and slips a little (PhysX)."""
    down: float = 0.005
    """m above its lowest point within which the tip is down."""
    rested: float = 0.0003
    """m from its farthest point within which the tip rests."""
    settle: float = 0.3
    """s after the tip's stop from which images show the object at rest."""
    begun: float = 0.006
    """m of its path from which the tip surely moves the object."""
    turned: float = radians(8.0)
    """rad, largest turn of an object that follows."""
    far: float = 0.012
    """m, shortest path of the object."""
    images: int = 12
    """Smallest number of images of a push."""
    corners: int = 4
    """Smallest number of corners of an image: three numbers of eight."""
    least: int = 3
    """Smallest number of consistent pushes."""
    wrong: float = 1.0
    """px from which a corner of an image counts less."""
    play: float = 0.0005
    """m by which an oscillating tip yields or slips to either side: rubber of 10 kN/m, 4 N."""
    sways: float = 0.004
    """s, further error of an oscillation: slip under the tip is more than play (two engines: -9 to 4 ms)."""
    follows: float = 0.8
    """Smallest share of the tip's oscillation that the object follows."""
    rows: tuple[float, float] = (0.008, 0.008)
    """s from an image's first row to its last: usual, deviation; 0 for a global shutter, 10 to 22 ms published."""
    far_off: float = 2.0
    """Deviations from the others from which a push counts less."""
    own: float = 0.001
    """s, error of one push, at least: the object turns, and stops softly."""
    common: float = 0.001
    """s, common error of all pushes: stamps are of states and images."""
    seen: float = 0.003
    """s, smallest delay that is reported: the detection limit of the effect."""


@dataclass(frozen=True)
class HandEye:
    """Contact with faces against where they are in the image (`sim2real.task.suite.hand_eye_offset`)."""

    least: int = 3
    """Smallest number of faces that were touched."""
    square: float = 0.94
    """Smallest cosine of the angle between a push and its face: 20 degrees."""
    face: float = 0.0006
    """m, error of one face: position in some images, after a soft stop."""
    common: float = 0.0004
    """m, common error of all faces: joint angles, and the image of an object at rest."""
    left: float = 0.004
    """m of remaining error from which the faces are unexplained."""
    picture: tuple[float, float] = (0.001, 0.008)
    """m, offset of the image; hand-eye calibrations: 4 to 29 mm."""
    out: float = 0.006
    """m by which every face is met farther out than its image (two engines: 0 and 6 mm)."""


@dataclass(frozen=True)
class TapSlides:
    """Objects that slide after a tap (`sim2real.task.contact_force.tap_slide`)."""

    down: float = 0.005
    """m above its lowest point within which the tip is down."""
    square: float = 0.94
    """Smallest cosine of the angle between a tap and its face: 20 degrees."""
    face: float = 0.0008
    """m, error of a face's resting place: 0.6 mm of a touched one, and it turns a little."""
    slows: tuple[float, float] = (0.3, 30.0)
    """m/s^2, smallest and largest deceleration."""
    sooner: float = 2.5
    """Deviations by which every tapped object stops sooner than its weight explains."""
    least: int = 2
    """Smallest number of slides."""


@dataclass(frozen=True)
class ObjectMotion:
    """The object's motion, simulated from where it rests (`sim2real.task.object_motion`)."""

    down: float = 0.015
    """m above its lowest point within which the tip may touch the object."""
    rested: float = 0.4
    """s of images before that which show where the object rests."""
    after: float = 0.5
    """s after it in which the object comes to rest and late images arrive."""
    least: float = 0.8
    """s, shortest window."""
    stiffness: float = 100.0
    """Nm/rad with which the last joint follows its path; other joints have more."""
    rougher: tuple[float, ...] = (-0.035, 0.0, 0.035)
    """Relative changes of the table's friction over which windows are averaged: a weak stroke sticks or slips by chance."""
    draws: int = 1000
    """Draws of windows for the interval of a share."""


@dataclass(frozen=True)
class Occlusion:
    """Corners that the hand hides (`sim2real.task.suite.occlusion`)."""

    first: float = 1.0
    """s of images that show how the object lies."""
    beside: float = 0.006
    """m around the hand within which it may hide a corner: images are late."""
    before: float = 0.985
    """Share of the line to a corner up to which something hides it; contact with its face does not."""


@dataclass(frozen=True)
class StaticScene:
    """Whether an untouched object rests in the image (`sim2real.task.suite.static_scene`)."""

    moved: float = 0.7
    """px from its median place from which the image moves by itself: 1.4 mm."""
    step: float = 2.0
    """px of a step from one image to the next beyond its neighbours: 12 cm/s, where the hand moves at 6."""
    surely: float = 6.0
    """Smallest ratio of such a motion or step to its noise."""
    draws: int = 20
    """Draws of independent corners, where noise is reported."""
    beyond: float = 1.3
    """Smallest ratio of a step to the largest of those draws."""
    least: float = 1.0
    """s, shortest stretch without a hand."""
    above: float = 0.015
    """m above the object's top below which a tip may touch it: half of its clearance on the way."""
    beside: float = 0.015
    """m between the circles around tip and object within which they may touch: half the clearance of a table touch."""
    slow: float = 0.06
    """m/s of a tip whose object moves no faster than a step shows; drags and pushes: 0.03."""
    early: float = 0.15
    """s before a tip is faster than that in which no step is judged: stamps and medians."""
    window: int = 9
    """Images of a median."""
    corners: int = 4
    """Smallest number of visible corners of a stretch."""
    shown: float = 0.7
    """Smallest share of a stretch's images in which a corner is visible."""
    unlike: float = 2.0
    """Ratio to the largest change of scatter that independent corners explain, from which the scatter varies."""
    uneven: float = 1.25
    """Factor, one standard deviation, by which scatter varies from moment to moment."""


@dataclass(frozen=True)
class Hypotheses:
    """Competing hypotheses of the task diagnosis (`sim2real.task.hypotheses`); log Bayes factors as of the arm's effects."""

    candidates: float = 8.0
    """Equally probable effects among which an effect is drawn."""
    narrowed: float = 0.25
    """Share of a gap's spread to which a recording must narrow a parameter to identify it."""
