"""The task suite, experiment by experiment: each is planned from where the object is seen and where surfaces were felt."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.domains import Domain, Pose
from np_diagnosis.experiments.excitation import Segment
from np_diagnosis.experiments.task import contacts
from np_diagnosis.experiments.task.path import OutOfReach, joined, still
from np_diagnosis.experiments.task.room import Lain, Room

FAMILIES = ("view", "touch_table", "touch_object", "drag", "push", "tap", "scrape")
"""In the order in which they are made: what is felt first is used by what comes after."""
DRAGS = (0.0, 2.0, 5.0, 9.0)  # N, by which the object is pressed; without any the same way in the air, for comparison
PUSHES = ((0.0, 0.03), (0.35, 0.03), (0.0, 0.06), (-0.35, 0.03), (0.0, 0.03), (0.0, 0.045))
"""Of each push: place on the face, as a share of half its width from the middle, and m/s."""
TAPS = 2
FLATTEST = 0.02  # m: lower objects are not pushed from the side
STANDSTILL = 1.5  # s


@dataclass(frozen=True, eq=False)
class Situation:
    """What an experiment is planned from. q (7,) rad: where the arm rests. pose: of the object, as it is seen now. lowest: m, the least
    height of the tip since the last plan, which a touch has stopped at a surface; None at the beginning."""

    q: np.ndarray
    pose: Pose
    lowest: float | None = None


def check(only: Sequence[str]) -> None:
    """Raises ValueError for a name that is no family's."""
    for name in only:
        if name not in FAMILIES:
            raise ValueError(f"experiment {name!r}: expected one of {', '.join(FAMILIES)}")


Plans = Generator[list[Segment], Situation, None]


def task_suite(domain: Domain, first: Situation, only: Sequence[str] = (), camera: Camera = CAMERA) -> Plans:
    """Plans, one at a time: send the situation after each to get the next.

    only: families to make (all of FAMILIES). What is out of reach, or has no room, is left out. Raises ValueError for an unknown name.
    """
    check(only)
    return _plans(Room(domain, camera), first, [name for name in FAMILIES if not only or name in only])


def _plans(room: Room, now: Situation, families: list[str]) -> Plans:
    table = top = None  # heights m as they were felt
    lain = Lain.of(room.domain, now.pose)
    if "view" in families:
        now = yield [still("view", now.q, STANDSTILL)]
    if "touch_table" in families:
        felt = []
        for number, place in enumerate(room.places(lain), 1):
            plan = _joined(now, lambda: contacts.touch(f"touch_table_{number}", now.q, place, 0.0, room.clearance))
            if plan:
                now = yield plan
                felt.append(now.lowest)
        table = float(np.median(felt)) if felt else None
    table = table or 0.0
    if "touch_object" in families:
        where, expected = lain.centre[:2], table + lain.height
        if plan := _joined(now, lambda: contacts.touch("touch_object", now.q, where, expected, room.clearance)):
            now = yield plan
            top = now.lowest
    top = top or table + lain.height
    if "drag" in families:
        for number, force in enumerate(DRAGS):
            lain = Lain.of(room.domain, now.pose)
            if plan := _joined(now, lambda: contacts.drag(f"drag_{number}", now.q, lain, room, top, force)):
                now = yield plan
    if lain.height < FLATTEST:
        return
    used: dict[int, int] = {}
    for number, (share, speed) in enumerate(PUSHES if "push" in families else (), 1):
        now, used = yield from _push(room, now, used, table, _slow_push(f"push_{number}", share, speed))
    for number in range(1, TAPS + 1) if "tap" in families else ():
        now, used = yield from _push(room, now, used, table, contacts.TAP.named(f"tap_{number}"))
    if "scrape" in families and room.domain.obstacles:
        lain = Lain.of(room.domain, now.pose)
        if plan := _joined(now, lambda: contacts.scrape("scrape", now.q, lain, room, table)):
            yield plan


def _slow_push(name: str, share: float, speed: float) -> contacts.Push:
    """A slow push."""
    return replace(contacts.SLOW.named(name), share=share, speed=speed)


def _push(room: Room, now: Situation, used: dict[int, int], table: float, push: contacts.Push):
    """One push, from the side that has room, was used least, and leaves the object nearest to the middle of the room."""
    lain = Lain.of(room.domain, now.pose)
    middle = np.array([np.mean(room.domain.start.x), np.mean(room.domain.start.y)])
    options = []
    for normal, distance in lain.sides():
        shift = -normal * push.moves
        heading = round(float(np.arctan2(normal[1], normal[0])) / (np.pi / 2)) % 4
        if room.holds(lain, shift):
            away = float(np.linalg.norm(lain.centre[:2] + shift - middle))
            options.append((used.get(heading, 0), away, heading, normal, distance))
    for _, _, heading, normal, distance in sorted(options, key=lambda option: option[:2]):
        plan = _joined(now, lambda: contacts.push(push, now.q, lain, normal, distance, room, table))
        if plan:
            now = yield plan
            return now, {**used, heading: used.get(heading, 0) + 1}
    return now, used


def _joined(now: Situation, make) -> list[Segment]:
    """A plan with its transfer; empty where the arm cannot do it."""
    try:
        return joined(now.q, [make()])
    except OutOfReach:
        return []
