"""Thresholds of the stages that need the task suite."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

from sim2real.thresholds.camera import USUAL, spreads
from sim2real.thresholds.entry import JUDGEMENT, NUMERICS, threshold


@dataclass(frozen=True)
class TipForce:
    """Forces from joint torques (`sim2real.task.wrench`)."""

    rate: float = threshold(50.0, "1/s", "rows, means of the states in between", JUDGEMENT)
    turned: float = threshold(0.004, "rad/s", "speed from which on a joint's friction has turned over", JUDGEMENT)
    torque: float = threshold(0.03, "Nm", "error of a joint's torque beside friction", "torque sensors of the Panda")
    friction: float = threshold(0.05, "1", "share of a moving joint's friction that is not known", JUDGEMENT)
    left: float = threshold(
        0.2, "1", "of a joint's error that is left where its mean without contact is taken off", JUDGEMENT
    )


@dataclass(frozen=True)
class SurfaceContact:
    """Surfaces that the tip was stopped by (`sim2real.task.surface`)."""

    least: float = threshold(1.5, "N", "smallest force at which a surface is felt", "joints at rest hide .7 N")
    rows: int = threshold(8, "rows", "of contact, at least, to draw a line through", JUDGEMENT)
    agreed: float = threshold(0.002, "m", "between touched points and a plane, beyond which it is none", JUDGEMENT)
    angle: float = threshold(
        0.0002, "m", "error of one touch: joints' angles at another posture", ".3 mrad of one joint"
    )
    common: float = threshold(0.0002, "m", "error of all touches together", ".3 mrad of all joints alike")
    height: tuple[float, float] = spreads(0.0003, 0.008, "m", "table's height", "users report 10 to 20 mm")
    tilt: tuple[float, float] = spreads(radians(0.03), radians(0.4), "rad", "table's tilt, each axis", ".1 to 1 degree")
    size: tuple[float, float] = spreads(0.0006, 0.002, "m", "object's edge that stands upright", USUAL)


@dataclass(frozen=True)
class FrictionAndMass:
    """Friction and mass from forces of slow drags, pushes and scrapes (`sim2real.task.contact_force`)."""

    pressed: float = threshold(0.8, "N", "smallest press of a drag that counts", JUDGEMENT)
    moving: float = threshold(0.6, "1", "share of its speed from which on a stroke counts", JUDGEMENT)
    lifts: float = threshold(0.006, "m/s", "speed up or down up to which the tip goes along", JUDGEMENT)
    chatter: float = threshold(
        0.0008, "m/s", "mean speed up and down from which on the tip chatters", "seen in two engines"
    )
    rows: int = threshold(6, "rows", "fewest of a reading", JUDGEMENT)
    edge: int = threshold(2, "rows", "left out at either end of a stroke", JUDGEMENT)
    memory: float = threshold(4.0, "rows", "of which one says something new", JUDGEMENT)
    clear: float = threshold(0.001, "m", "over its lowest point, at which a scraping tip may meet the table", JUDGEMENT)
    slides: float = threshold(0.006, "m/s", "speed down a face from which on the tip slides on it", JUDGEMENT)
    held: float = threshold(2.0, "N", "force on a face from which on a scrape counts", JUDGEMENT)
    force: float = threshold(0.02, "N", "error of a stroke's or push's mean force beside their scatter", JUDGEMENT)
    relative: float = threshold(0.012, "1", "error of such a force, of itself", JUDGEMENT)
    face: float = threshold(0.5, "1", "share of a push that the tip's friction holds the face up or down by", JUDGEMENT)
    follows: float = threshold(0.8, "1", "share of a drag that the object is led along, to count", "tips that hop")
    slips: float = threshold(
        0.3, "1", "the same share, up to which the tip slips over an object that rests", "seen in two engines"
    )
    proportion: float = threshold(
        0.15,
        "1",
        "within which the log ratios of strokes that slip agree; a tip that hops has others",
        "seen in two engines",
    )
    surely: float = threshold(
        1.2,
        "1",
        "times the press from which on a tip of a coefficient leads the object, where it surely does",
        "two engines, tips of 1.0 and .5",
    )
    common: float = threshold(0.018, "N", "error that drags, or pushes one way, have in common", JUDGEMENT)
    usually: float = threshold(
        4.0, "readings", "that usual errors count as, beside how far off those of a recording are", JUDGEMENT
    )
    law: tuple[float, float] = threshold(
        (0.0, 0.015),
        "1",
        "log friction of a slow slide against the coefficient: mean, deviation",
        "two engines, under a tip that does not hop: -1.5 to .2 %",
    )
    table: tuple[float, float] = spreads(0.04, 0.35, "1", "log friction with the table", "10 to 20 % between set-ups")
    mass: tuple[float, float] = spreads(0.015, 0.35, "1", "log mass", "scales: 3 %; 30 % of a gap")
    finger: tuple[float, float] = spreads(0.1, 0.5, "1", "log friction of the fingertip", "rubber, worn or dusty")
    turning: float = threshold(
        0.04, "1", "by which the force of a push is off that turns the object", "seen in two engines"
    )
    central: float = threshold(0.005, "m", "from the object's centre, up to which a push does not turn it", JUDGEMENT)
    pull: float = threshold(0.1, "N", "that something else pulls the object by, at least", JUDGEMENT)
    apart: float = threshold(0.05, "m", "over which what pulls the object down may change by its unit", NUMERICS)
    pulled: float = threshold(
        12.0, "nats", "by which forces are more probable with it", "as sure as a verdict is: development cases"
    )
    misfit: float = threshold(
        3.0, "1", "times the usual errors that are left, beyond which it is unexplained", JUDGEMENT
    )


@dataclass(frozen=True)
class LatencyEstimate:
    """Images against the tip that pushes the object (`sim2real.task.suite.image_latency`)."""

    within: float = threshold(0.3, "s", "delays that are told", NUMERICS)
    way: float = threshold(0.0003, "m", "error of the object's way in one image", "a tenth of a pixel, eight corners")
    left: float = threshold(
        0.0012, "m", "root mean square of what is left of a way, beyond which it did not go along", JUDGEMENT
    )
    scale: float = threshold(
        2.0,
        "%",
        "by which the object goes less far than the tip: it turns, and slips a little",
        "development cases in PhysX",
    )
    down: float = threshold(0.005, "m", "over its lowest point, within which the tip is down", JUDGEMENT)
    rested: float = threshold(0.0003, "m", "from its farthest, within which the tip rests", JUDGEMENT)
    settle: float = threshold(0.3, "s", "after the tip has stopped, from which on the object is seen to rest", "delays")
    begun: float = threshold(0.006, "m", "on its way, from which on the tip surely has it", JUDGEMENT)
    turned: float = threshold(radians(8.0), "rad", "by which an object may turn that goes along", JUDGEMENT)
    far: float = threshold(0.012, "m", "that the object goes, at least", JUDGEMENT)
    images: int = threshold(12, "images", "of a push, at least", JUDGEMENT)
    corners: int = threshold(4, "corners", "of an image, at least: three numbers are asked of eight", JUDGEMENT)
    least: int = threshold(3, "pushes", "that say the same", JUDGEMENT)
    wrong: float = threshold(1.0, "px", "from which on a corner of an image counts less", JUDGEMENT)
    play: float = threshold(
        0.0005, "m", "to either side, by which a tip that sways the object gives way or slips", "rubber of 10 kN/m, 4 N"
    )
    sways: float = threshold(
        0.004,
        "s",
        "error of a sway beside: what slips under the tip is no play alone",
        "a card in two engines: -9 to 4 ms",
    )
    follows: float = threshold(0.8, "1", "share of a tip's sway that the object goes along, at least", "as of drags")
    rows: tuple[float, float] = threshold(
        (0.008, 0.008),
        "s",
        "from a picture's first row to its last: usual, deviation",
        "a global shutter: 0; others read our part of a frame at 30 Hz in 10 to 22 ms (published)",
    )
    far_off: float = threshold(2.0, "1", "deviations from the others from which on a push counts less", JUDGEMENT)
    own: float = threshold(0.001, "s", "error of one push, at least: it turns, and comes to rest softly", JUDGEMENT)
    common: float = threshold(0.001, "s", "error of all pushes: stamps are of states and images", JUDGEMENT)
    seen: float = threshold(0.003, "s", "delay that is named, if it is surely more", "limit of the effect")


@dataclass(frozen=True)
class HandEye:
    """Faces that are pushed against where they are seen (`sim2real.task.suite.hand_eye_offset`)."""

    least: int = threshold(3, "faces", "that were met, at least", JUDGEMENT)
    square: float = threshold(0.94, "1", "cosine of the angle between a push and its face, at least", "20 degrees")
    face: float = threshold(0.0006, "m", "error of one face: as seen in some images, after a soft stop", JUDGEMENT)
    common: float = threshold(
        0.0004, "m", "error of all faces: joints' angles, what an object at rest is seen off by", JUDGEMENT
    )
    left: float = threshold(0.004, "m", "that is left of the faces, beyond which it is unexplained", JUDGEMENT)
    picture: tuple[float, float] = spreads(
        0.001, 0.008, "m", "by which things are seen off", "hand-eye calibrations: 4 to 29 mm"
    )
    out: float = threshold(
        0.006, "m", "by which every face is met farther out than it is seen", "two engines: 0 and 6 mm"
    )


@dataclass(frozen=True)
class TapSlides:
    """Objects that slide after a tap (`sim2real.task.contact_force.tap_slide`)."""

    down: float = threshold(0.005, "m", "over its lowest point, within which the tip is down", JUDGEMENT)
    square: float = threshold(0.94, "1", "cosine of the angle between a tap and its face, at least", "20 degrees")
    face: float = threshold(
        0.0008, "m", "error of where a face comes to rest", ".6 mm of one that is met, and it turns a little"
    )
    slows: tuple[float, float] = threshold((0.3, 30.0), "m/s^2", "slowest and fastest that are told", NUMERICS)
    sooner: float = threshold(
        2.5, "1", "deviations by which every object that was tapped stops sooner than by its weight", JUDGEMENT
    )
    least: int = threshold(2, "slides", "that say so", JUDGEMENT)


@dataclass(frozen=True)
class ObjectMotion:
    """The object's motion, simulated from where it rests (`sim2real.task.object_motion`)."""

    down: float = threshold(0.015, "m", "over its lowest point, within which the tip may touch the object", JUDGEMENT)
    rested: float = threshold(0.4, "s", "before that, of images that show where the object rests", JUDGEMENT)
    after: float = threshold(0.5, "s", "after it, in which the object comes to rest and late images come", JUDGEMENT)
    least: float = threshold(0.8, "s", "of a window", JUDGEMENT)
    stiffness: float = threshold(
        100.0,
        "Nm/rad",
        "by which the wrist's last joint is led along its way, other joints by more",
        "tried on development cases",
    )
    rougher: tuple[float, ...] = threshold(
        (-0.035, 0.0, 0.035),
        "1",
        "by which the table's friction is more than the patch says, over which windows are averaged",
        "within which a weak stroke holds the object or slips by chance",
    )
    draws: int = threshold(1000, "draws", "of windows, for the interval of a share", NUMERICS)


@dataclass(frozen=True)
class Occlusion:
    """Corners that the hand hides (`sim2real.task.suite.occlusion`)."""

    first: float = threshold(1.0, "s", "of images that tell how the object lies", JUDGEMENT)
    beside: float = threshold(
        0.006, "m", "about the hand, within which it may hide a corner: images are late", JUDGEMENT
    )
    before: float = threshold(
        0.985, "1", "of the way to a corner, up to which something hides it: what touches its face does not", JUDGEMENT
    )


@dataclass(frozen=True)
class StaticScene:
    """Whether an object rests in the picture that nothing touches (`sim2real.task.suite.static_scene`)."""

    moved: float = threshold(
        0.7, "px", "from its middle place, from which on the picture moves by itself: 1.4 mm", JUDGEMENT
    )
    step: float = threshold(
        2.0, "px", "beyond those about it, of one image to the next: 12 cm/s, where the hand goes 6", JUDGEMENT
    )
    surely: float = threshold(6.0, "1", "times the noise of such a way or step, that it is at least", JUDGEMENT)
    draws: int = threshold(20, "draws", "of what corners do each for itself, where noise is named", NUMERICS)
    beyond: float = threshold(1.3, "1", "times the most of those draws, that a step is at least", JUDGEMENT)
    least: float = threshold(1.0, "s", "of a stretch without a hand", JUDGEMENT)
    above: float = threshold(
        0.015, "m", "over the object's top, below which a tip may touch it: half of what it keeps on its way", JUDGEMENT
    )
    beside: float = threshold(
        0.015,
        "m",
        "between the circles about tip and object, within which they may touch: half of what a touch of the table keeps",
        JUDGEMENT,
    )
    slow: float = threshold(
        0.06, "m/s", "of a tip whose object goes no faster than a step tells", "drags and pushes: .03"
    )
    early: float = threshold(
        0.15, "s", "before a tip is faster than that, in which a step is not judged yet: stamps and medians", JUDGEMENT
    )
    window: int = threshold(9, "images", "of which a median is taken", NUMERICS)
    corners: int = threshold(4, "corners", "that are seen in a stretch", JUDGEMENT)
    shown: float = threshold(0.7, "1", "share of a stretch's images in which a corner that is seen counts", JUDGEMENT)
    unlike: float = threshold(
        2.0, "1", "times the most that each corner's own scatter makes of it, that scatter goes up and down", JUDGEMENT
    )
    uneven: float = threshold(
        1.25, "1", "factor, one standard deviation, by which scatter goes up and down from moment to moment", JUDGEMENT
    )


@dataclass(frozen=True)
class Hypotheses:
    """Competing hypotheses of the task diagnosis (`sim2real.task.hypotheses`); log Bayes factors are those of the arm's effects."""

    candidates: float = threshold(8.0, "candidates", "equally probable effects that an effect is one of", JUDGEMENT)
    narrowed: float = threshold(0.25, "1", "of a gap's spread to which a recording must narrow it to see it", JUDGEMENT)
