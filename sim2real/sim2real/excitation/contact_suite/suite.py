"""The task suite, experiment by experiment: each is planned from where the object is seen and where surfaces were touched."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.domains import Pose, Task
from sim2real.excitation.contact_suite import contact_motions as contacts
from sim2real.excitation.contact_suite.tip_path import OutOfReach, join_segments, rest_segment
from sim2real.excitation.contact_suite.workspace import RestingObject, Workspace
from sim2real.excitation.suite import Segment

FAMILIES = ("view", "touch_table", "touch_object", "drag", "sway", "push", "shove", "tap", "scrape")
"""In the order in which they are made: what is touched first is used by what comes after."""
DRAGS = (0.0, 1.5, 2.5, 5.0, 9.0)
"""N, by which the object is pressed: none, the same way in the air, for comparison; little, so that a smooth fingertip slips more than once on
the way back, where it presses half as much; not so little that a rough one hops; much."""
PUSHES = ((0.0, 0.03), (0.35, 0.03), (0.0, 0.03), (-0.35, 0.03), (0.0, 0.03))
"""Of each push: place on the face, as a share of half its width from the middle, and m/s."""
SHOVES, TAPS = 3, 2
TOUCHES = 3  # of a place, each deeper than the one before, until something is touched
BACK = 2  # pushes, at most, that bring the object to where it has room to more sides
BACK_BY = (0.015, 0.025, 0.035, 0.05)  # m by which they may
FLATTEST = 0.02  # m: lower objects are not pushed from the side
STANDSTILL = 1.5  # s


@dataclass(frozen=True, eq=False)
class SuiteState:
    """What an experiment is planned from."""

    q: np.ndarray
    """(7,) rad, where the arm rests."""
    pose: Pose
    """Of the object, as it is seen now."""
    lowest: float | None = None
    """m, least height of the tip since the last plan, at which a surface stopped a touch; None at the beginning."""


def check_families(only: Sequence[str]) -> None:
    """Raises ValueError for a name that is no family's."""
    for name in only:
        if name not in FAMILIES:
            raise ValueError(f"experiment {name!r}: expected one of {', '.join(FAMILIES)}")


Plans = Generator[list[Segment], SuiteState, None]


def task_suite(domain: Task, first: SuiteState, only: Sequence[str] = (), camera: Camera = CAMERA) -> Plans:
    """Plans, one at a time: send the situation after each to get the next.

    only: families to make (all of FAMILIES). What is out of reach, or has no workspace, is left out. Raises ValueError for an unknown name.
    """
    check_families(only)
    return _plan_experiments(Workspace(domain, camera), first, [name for name in FAMILIES if not only or name in only])


def _plan_experiments(workspace: Workspace, now: SuiteState, families: list[str]) -> Plans:
    table = top = None  # heights m as they were touched
    resting = RestingObject.of(workspace.domain, now.pose)
    if "view" in families:
        now = yield [rest_segment("view", now.q, STANDSTILL)]
    if "touch_table" in families:
        touched: list[float] = []
        for place in workspace.touch_places(resting):
            expected = touched[-1] if touched else 0.0
            now, stopped = yield from _touch_surface(workspace, now, "touch_table", len(touched) + 1, place, expected)
            touched += [] if stopped is None else [stopped]
        table = float(np.median(touched)) if touched else None
    if "touch_object" in families:
        expected = (table or 0.0) + resting.height
        now, top = yield from _touch_surface(workspace, now, "touch_object", 0, resting.centre[:2], expected)
    if table is None:
        table = top - resting.height if top else 0.0
    top = top or table + resting.height
    used: dict[int, int] = {}
    if resting.height > FLATTEST and {"drag", "push", "shove"} & set(families):
        now, used = yield from _push_back(workspace, now, used, table)
    if "drag" in families:
        for number, force in enumerate(DRAGS):
            resting = RestingObject.of(workspace.domain, now.pose)
            if plan := _plan_with_transfer(
                now, lambda: contacts.drag(f"drag_{number}", resting, workspace, top, force)
            ):
                now = yield plan
    if "sway" in families:
        resting = RestingObject.of(workspace.domain, now.pose)
        if plan := _plan_with_transfer(now, lambda: contacts.sway("sway", resting, workspace, top)):
            now = yield plan
    if resting.height < FLATTEST:
        return
    for number, (share, speed) in enumerate(PUSHES if "push" in families else (), 1):
        now, used = yield from _push_object(workspace, now, used, table, _slow_push(f"push_{number}", share, speed))
    for count, how in ((SHOVES, contacts.SHOVE), (TAPS, contacts.TAP)):
        for number in range(1, count + 1) if how.name in families else ():
            now, used = yield from _push_object(workspace, now, used, table, how.with_name(f"{how.name}_{number}"))
    if "scrape" in families and workspace.domain.obstacles:
        resting = RestingObject.of(workspace.domain, now.pose)
        if plan := _plan_with_transfer(now, lambda: contacts.scrape("scrape", resting, workspace, table)):
            yield plan


def _slow_push(name: str, share: float, speed: float) -> contacts.Push:
    """A slow push."""
    return replace(contacts.SLOW.with_name(name), share=share, speed=speed)


def _touch_surface(workspace: Workspace, now: SuiteState, name: str, number: int, place: np.ndarray, expected: float):
    """Down until something is touched, each time deeper; the height m at which the tip was stopped, None where it never was, with the situation
    after it. number: of the experiment, 0 for one that has none; expected: m, of the surface."""
    for deeper in range(TOUCHES):
        surface = expected - deeper * contacts.DEEPER
        called = f"{name}_{number}" if number else name  # one that met nothing gives its name to the next
        plan = _plan_with_transfer(now, lambda: contacts.touch(called, place, surface, workspace.clearance))
        if not plan:
            break
        now = yield plan
        if now.lowest is not None and now.lowest > surface - contacts.DEEPER + contacts.HELD_UP:
            return now, now.lowest
    return now, None


def _push_back(workspace: Workspace, now: SuiteState, used: dict[int, int], table: float):
    """Pushes that bring the object to where it can be pushed to more sides than where it lies."""
    for number in range(1, BACK + 1):
        resting = RestingObject.of(workspace.domain, now.pose)
        best, push, normal, distance = len(sides_with_room(workspace, resting, contacts.SLOW)), None, None, 0.0
        for travel in BACK_BY:
            longer = replace(contacts.SLOW.with_name(f"push_{10 * number}"), travel=travel)
            for outward, away in sides_with_room(workspace, resting, longer):
                room_after = len(sides_with_room(workspace, resting.shift(-outward * travel), contacts.SLOW))
                if room_after > best:
                    best, push, normal, distance = room_after, longer, outward, away
        if push is None:
            break
        plan = _plan_with_transfer(now, lambda: contacts.push(push, resting, normal, distance, workspace, table))
        if not plan:
            break
        now = yield plan
        used = {**used, _heading(normal): used.get(_heading(normal), 0) + 1}
    return now, used


def sides_with_room(
    workspace: Workspace, resting: RestingObject, push: contacts.Push
) -> list[tuple[np.ndarray, float]]:
    """Normals (2,) of faces, with their distances m from the centre, from which a push has workspace."""
    return [
        (normal, distance)
        for normal, distance in resting.sides()
        if workspace.allows(resting, -normal * push.displacement)
    ]


def _heading(normal: np.ndarray) -> int:
    return round(float(np.arctan2(normal[1], normal[0])) / (np.pi / 2)) % 4


def _push_object(workspace: Workspace, now: SuiteState, used: dict[int, int], table: float, push: contacts.Push):
    """One push, from the side that has workspace, was used least, and leaves the object nearest to the middle of the workspace."""
    resting = RestingObject.of(workspace.domain, now.pose)
    middle = np.array([np.mean(workspace.domain.start.x), np.mean(workspace.domain.start.y)])
    options = []
    for normal, distance in sides_with_room(workspace, resting, push):
        away = float(np.linalg.norm(resting.centre[:2] - normal * push.displacement - middle))
        options.append((used.get(_heading(normal), 0), away, normal, distance))
    for _, _, normal, distance in sorted(options, key=lambda option: option[:2]):
        plan = _plan_with_transfer(now, lambda: contacts.push(push, resting, normal, distance, workspace, table))
        if plan:
            now = yield plan
            return now, {**used, _heading(normal): used.get(_heading(normal), 0) + 1}
    return now, used


def _plan_with_transfer(now: SuiteState, make) -> list[Segment]:
    """A plan with its transfer; empty where the arm cannot do it."""
    try:
        return join_segments(now.q, [make()])
    except OutOfReach:
        return []
