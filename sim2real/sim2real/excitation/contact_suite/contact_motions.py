"""What the tip does to table and object: touch, drag and sway from above, push, shove, tap, scrape. Each is one segment that begins and ends high up."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim2real.excitation.contact_suite.tip import EDGE, GRIP, RADIUS, leading_yaw
from sim2real.excitation.contact_suite.tip_path import Leg, Oscillation, OutOfReach, make_segment, press_depth
from sim2real.excitation.contact_suite.workspace import RestingObject, Workspace, is_reachable
from sim2real.excitation.suite import Segment

CLEAR = 0.03  # m over whatever is there, at which the hand travels
FAST = 0.12  # m/s on the way
BEFORE = 0.025  # m over a surface from which on the tip comes slowly: tables are up to 2 cm higher than nominal
SLOW_TOUCH = 0.02  # m/s
DEEPER = 0.008  # m below a surface's nominal height, down to which the tip is sent
HELD_UP = 0.003  # m over there, at which a tip was stopped: one that is free is less far off
STROKE, STROKE_SPEED = 0.028, 0.03  # m and m/s of a drag
BEHIND = 0.02  # m behind the middle, where a drag presses: a tall object would tip over its leading edge
SWAY, SWAYS, SWAY_FORCE = 0.012, (1.6, 4), 9.0
"""m to either side; period s and how many; N by which a tip leads an object that it sways: as the strongest of drags, so that it does not slip."""
ROCKS = 1.6  # times the nominal table friction up to which an object must not tip over an edge when its top is led
HEADINGS = (np.array([1.0, 0.0]), np.array([-1.0, 0.0]), np.array([0.0, 1.0]), np.array([0.0, -1.0]))
OVER = 0.015  # m over obstacles
LEAVE = 0.012  # m by which the tip backs off
BACK = 0.2  # m/s, at which it does so after a tap
# m: a scrape leaves the object so far from its obstacle, backs off, and comes down its face from so far below its top, while it goes into
# it: a tip that slides down holds the object down, where one that only presses would tip it over the obstacle.
GAP, AWAY, BELOW, INTO, DOWN_SPEED = 0.006, 0.005, 0.015, 0.009, 0.012
TALL = 0.03  # m: of an obstacle that holds an object


@dataclass(frozen=True)
class Push:
    """A push from the side."""

    name: str
    """Name of the experiment."""
    share: float
    """Place on the face from its middle, in units of half its width."""
    speed: float
    """m/s."""
    run_up: float
    """m without contact."""
    travel: float
    """m with the object, from where it is seen."""
    stop: float
    """s in which the tip comes to rest."""
    slides: float
    """m that the object may slide on by itself."""
    shove: float = 0.0
    """m that the tip then moves the object quickly, from rest to rest."""

    @property
    def displacement(self) -> float:
        """m by which the object is moved."""
        return self.travel + self.slides + self.shove

    def with_name(self, name: str) -> Push:
        """The same, called so."""
        return replace(self, name=name)


SLOW = Push("push", 0.0, 0.03, 0.03, 0.025, 0.12, 0.0)
SHOVE = Push("shove", 0.0, 0.04, 0.02, 0.009, 0.12, 0.0, shove=0.02)
QUICK = (
    0.13,
    0.13,
)  # m/s of a shove, and s in which it gets there and comes to rest: an object on a smooth table keeps with the tip
TAP = Push("tap", 0.0, 0.35, 0.05, 0.018, 0.04, 0.018)


def touch(name: str, place: np.ndarray, surface: float, obstacles: float) -> Segment:
    """Down onto a `surface` m at a place (2,) m and up again; obstacles: m, height to keep clear of."""
    high = np.array([*place, max(surface, obstacles, 0.09) + CLEAR])
    near, deep = np.array([*place, surface + BEFORE]), np.array([*place, surface - DEEPER])
    return make_segment(name, high, [Leg(near, FAST), Leg(deep, SLOW_TOUCH, rest=0.3), Leg(high, FAST)], 0.0)


def drag(name: str, resting: RestingObject, workspace: Workspace, top: float, force: float) -> Segment:
    """Press the object's top, felt at `top` m, and lead it there and back; without a force the same way in the air."""
    middle = resting.centre[:2]
    high = np.array([*middle, max(top, workspace.clearance) + CLEAR])
    down = high - [0, 0, high[2] - top]
    at = make_segment(name, high, [Leg(down, FAST)], 0.0).positions[-1]
    level = top - press_depth(at, force) if force else top + 0.01
    heading = next((direction for direction in HEADINGS if workspace.allows(resting, STROKE * direction)), None)
    if heading is None:
        raise OutOfReach(f"{name}: no room to drag the object in")
    legs = []
    for begin, direction in ((-BEHIND * heading, heading), ((STROKE + BEHIND) * heading, -heading)):
        first, last = middle + begin, middle + begin + STROKE * direction
        legs += [
            Leg(np.array([*first, top + BEFORE]), FAST),
            Leg(np.array([*first, level]), SLOW_TOUCH, rest=0.2),
            Leg(np.array([*last, level]), STROKE_SPEED, rest=0.2),
            Leg(np.array([*last, top + BEFORE]), FAST, rest=0.2),
        ]
    legs += [Leg(high, FAST)]
    return make_segment(name, high, legs, 0.0)


def sway(name: str, resting: RestingObject, workspace: Workspace, top: float) -> Segment:
    """Press the object's top, felt at `top` m, in its middle, and lead it to and fro. Raises OutOfReach for one that is so tall that it would rock:
    a drag presses it behind its middle for that, which a sway cannot both ways."""
    if ROCKS * workspace.domain.contact.table * resting.height > min(distance for _, distance in resting.sides()):
        raise OutOfReach(f"{name}: the object would rock on its edges")
    middle = resting.centre[:2]
    high = np.array([*middle, max(top, workspace.clearance) + CLEAR])
    at = make_segment(name, high, [Leg(np.array([*middle, top]), FAST)], 0.0).positions[-1]
    for direction in HEADINGS[::2]:
        if workspace.allows(resting, SWAY * direction) and workspace.allows(resting, -SWAY * direction):
            legs = [
                Leg(np.array([*middle, top + BEFORE]), FAST),
                Leg(np.array([*middle, top - press_depth(at, SWAY_FORCE)]), SLOW_TOUCH, rest=0.3),
                Oscillation(SWAY * np.array([*direction, 0.0]), *SWAYS, rest=0.6),
                Leg(high, FAST),
            ]
            return make_segment(name, high, legs, 0.0)
    raise OutOfReach(f"{name}: no room to sway the object in")


def push(
    how: Push, resting: RestingObject, normal: np.ndarray, distance: float, workspace: Workspace, table: float
) -> Segment:
    """Push the face with this outward normal (2,), `distance` m from the object's centre; table: its height m as felt."""
    ahead, across = -normal, np.array([-normal[1], normal[0]])
    width = max(abs(float(corner @ across)) for corner in (resting.corners(np.zeros(2)) - resting.centre)[:, :2])
    place = resting.centre[:2] + normal * distance + across * how.share * width
    low = max(_tip_height(resting, workspace, table), table + resting.height - EDGE)
    begin, end, last = (place - ahead * (RADIUS + back) for back in (how.run_up, -how.travel, -how.travel - how.shove))
    if not (is_reachable(begin) and is_reachable(last)):
        raise OutOfReach(f"{how.name}: the way of the tip is out of reach")
    high, out = table + resting.height + CLEAR, last - ahead * LEAVE
    legs = [
        Leg(np.array([*begin, low]), FAST, rest=0.3),
        Leg(np.array([*end, low]), how.speed, rest=0.0 if how.slides else 0.6, stop=how.stop),
        *([Leg(np.array([*last, low]), QUICK[0], rest=0.6, ramp=QUICK[1], stop=QUICK[1])] if how.shove else []),
        # A tip that only stops comes to rest no sooner than what it has tapped, and holds it: it draws back at once.
        Leg(np.array([*out, low]), BACK, rest=0.6, ramp=how.stop, stop=how.stop)
        if how.slides
        else Leg(np.array([*out, low]), how.speed),
        Leg(np.array([*out, high]), FAST, rest=1.0),
    ]
    return make_segment(how.name, np.array([*begin, high]), legs, leading_yaw(ahead))


def _tip_height(resting: RestingObject, workspace: Workspace, table: float) -> float:
    """Height m of the tip's end beside the object: over obstacles, no deeper than the hand allows."""
    return table + max(
        workspace.clearance + OVER if workspace.clearance else 0.0, resting.height - GRIP, 0.3 * resting.height
    )


def scrape(name: str, resting: RestingObject, workspace: Workspace, table: float) -> Segment:
    """Hold the object against an obstacle with the tip, and lead the tip down its face. Raises OutOfReach without such an obstacle."""
    found = []
    for box in workspace.domain.obstacles:
        for axis in range(2):
            for sign in (-1.0, 1.0):
                outward = sign * np.eye(2)[axis]
                face = np.array(box.centre[:2]) + outward * box.half_size[axis]
                gap = float((resting.centre[:2] - face) @ outward)
                along = abs(resting.centre[1 - axis] - box.centre[1 - axis])
                if gap > 0 and along < box.half_size[1 - axis] - 0.5 * resting.reach and box.half_size[2] * 2 >= TALL:
                    found.append((gap, outward))
    if not found:
        raise OutOfReach(f"{name}: no obstacle beside the object that could hold it")
    gap, outward = min(found, key=lambda one: one[0])
    normal, distance = max(resting.sides(), key=lambda side: float(side[0] @ outward))
    depth = 2 * distance
    low, top = _tip_height(resting, workspace, table), table + resting.height - BELOW
    place = resting.centre[:2] + normal * distance
    begin = place + outward * (RADIUS + 0.02)
    # The tip's place once the object lies flat against the obstacle, and its edge in the middle of the face.
    flush = resting.centre[:2] - outward * (gap - depth) + outward * RADIUS
    near = flush + outward * GAP
    legs = [
        Leg(np.array([*begin, low]), FAST, rest=0.2),
        Leg(np.array([*near, low]), 0.03, rest=0.1),
        Leg(np.array([*near + outward * AWAY, low]), 0.03),
        Leg(np.array([*near + outward * AWAY, top]), FAST, rest=0.2),
        Leg(np.array([*flush - outward * INTO, low]), DOWN_SPEED, rest=0.2),
        Leg(np.array([*flush + outward * LEAVE, low]), 0.03),
        Leg(np.array([*flush + outward * LEAVE, table + resting.height + CLEAR]), FAST, rest=1.0),
    ]
    high = np.array([*begin, table + resting.height + CLEAR])
    return make_segment(name, high, legs, leading_yaw(-outward))
