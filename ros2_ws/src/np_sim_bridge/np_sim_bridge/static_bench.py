"""Contact against rigid theory: press, drag, slide, creep, push off centre, tip over, draw along a wall. The same questions to every engine.

    python -m np_sim_bridge.static_bench [--contact soft|hard]

The last line printed is one JSON object.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from functools import partial

import numpy as np

from np_common.rotations import matrix_from_quaternion
from np_description.contact.model import CONTACTS, ContactModel, find_contact
from np_description.engine import MakeEngine
from np_description.mujoco_engine import MujocoEngine
from np_sim_bridge import hand_bench
from np_sim_bridge.box_world import DOWNWARDS, FORWARDS, GRAVITY, STEP, TIP_RADIUS, BoxOnTable, BoxWorld, MujocoBoxWorld

Make = Callable[[BoxOnTable], BoxWorld]

CARD = BoxOnTable((0.025, 0.035, 0.0025), 0.008)
CUBE = BoxOnTable((0.045, 0.045, 0.045), 0.146)
TALL = BoxOnTable((0.025, 0.025, 0.05), 0.038)
FORCES = (1.0, 5.0, 10.0, 20.0, 31.0)  # N
ROUGH = 0.5  # coefficient of a wall, half of the fingertip's
HEADINGS = (0.0, 10.0, 20.0, 30.0, 45.0, 60.0, 90.0)  # degrees, downhill


def _turn(world: BoxWorld) -> float:
    """Rotation of the box about the vertical, rad."""
    rotation = matrix_from_quaternion(world.pose().quaternion)
    return float(np.arctan2(rotation[1, 0], rotation[0, 0]))


def _lead_along(world: BoxWorld, start: np.ndarray, way, seconds: float, steps: int, force: float = 0.0) -> None:
    """Lead the finger evenly from `start` by `way` (3,) m in so many steps; where it presses, with `force` N."""
    for k in range(steps):
        world.lead(start + np.array(way) * (k + 1) / steps, press=force)
        world.step(seconds / steps)


def _bracket_tipping(tips: Callable[[float], bool], low: float, high: float) -> tuple[float, float]:
    """Largest value that does not tip a box and smallest that does, between `low` and `high`, by bisection."""
    for _ in range(8):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if tips(middle) else (middle, high)
    return low, high


def press(make: Make) -> dict:
    """A fingertip pressed on the card: how deep it is in it, and the card in the table, mm, by force N. Measured from
    their poses, not from the engine's contacts: an engine that lets the finger through reports none."""
    above = (0.0, 0.0, 2 * CARD.half_size[2] + TIP_RADIUS)
    rows = []
    for force in FORCES:
        world = make(BoxOnTable(CARD.half_size, CARD.mass, above, pressing=DOWNWARDS))
        world.lead(np.array(above), press=force)
        world.step(1.5)
        pose, half = world.pose(), np.array(CARD.half_size)
        upright = matrix_from_quaternion(pose.quaternion)
        into_card = half[2] + TIP_RADIUS - (world.tip() - pose.position) @ upright[:, 2]
        into_table = half @ np.abs(upright[2]) - pose.position[2]
        rows.append({"force": force, "finger_mm": 1e3 * float(into_card), "table_mm": 1e3 * float(into_table)})
    return {"rows": rows}


def drag(make: Make, force: float = 5.0, distance: float = 0.03) -> dict:
    """A pressed fingertip drawn sideways: the card sticks to rubber and comes along, mm of mm."""
    above = np.array([0.0, 0.0, 2 * CARD.half_size[2] + TIP_RADIUS])
    world = make(BoxOnTable(CARD.half_size, CARD.mass, tuple(above), pressing=DOWNWARDS))
    world.lead(above, press=force)
    world.step(1.0)
    began = world.pose().position[0]
    _lead_along(world, above, [distance, 0.0, 0.0], 3.0, 150, force)
    world.step(0.3)
    return {"drawn_mm": 1e3 * distance, "followed_mm": 1e3 * float(world.pose().position[0] - began)}


def drag_off_centre(make: Make, force: float = 5.0, offset: float = 0.02, distance: float = 0.06) -> dict:
    """A fingertip pressed beside the card's middle and drawn across: how far the card turns, degrees. Not at all: friction with the
    table has its centre where the load has, which is below the tip, and the card weighs next to nothing."""
    above = np.array([0.0, offset, 2 * CARD.half_size[2] + TIP_RADIUS])
    world = make(BoxOnTable(CARD.half_size, CARD.mass, tuple(above), pressing=DOWNWARDS))
    world.lead(above, press=force)
    world.step(1.0)
    _lead_along(world, above, [distance, 0.0, 0.0], 3.0, 600, force)
    return {"turned_deg": abs(float(np.degrees(_turn(world))))}


def tip_off_wall(make: Make, force: float = 10.0, distance: float = 0.03, seconds: float = 0.6) -> dict:
    """A fingertip presses a weightless box on a wall and is drawn sideways: how far ahead of the middle it may press, mm, until the box
    tips about its leading edge.

    Friction on the wall and on the tip are a couple, which moves the wall's pressure ahead of the tip by the coefficient times the box's
    depth. Beyond the edge of the box nothing presses back.
    """
    half = TALL.half_size

    def tips(ahead: float) -> bool:
        start = np.array([-half[0] - TIP_RADIUS, ahead, half[2]])
        world = make(BoxOnTable(half, TALL.mass, tuple(start), pressing=FORWARDS, beside_wall=True))
        world.pull(np.array([0.0, 0.0, TALL.mass * GRAVITY]))
        world.lead(start, press=force)
        world.step(0.6)
        _lead_along(world, start, [0.0, distance, 0.0], seconds, round(seconds / STEP), force)
        return matrix_from_quaternion(world.pose().quaternion)[0, 0] < np.cos(0.1)

    return {"ahead_mm": 1e3 * _bracket_tipping(tips, -half[1], half[1])[0]}


def slide(make: Make, friction: float, heading: float) -> dict:
    """Down a slope steeper than the friction angle: the coefficient computed from the acceleration, over the true one."""
    angle, world = np.arctan(friction) + 0.15, make(CUBE)
    world.step(0.3)
    world.tilt(angle, heading)
    world.step(0.1)
    along, before = np.array([np.cos(heading), np.sin(heading), 0.0]), world.velocity()
    world.step(0.5)
    acceleration = float((world.velocity() - before) @ along) / 0.5
    found = np.tan(angle) - acceleration / (GRAVITY * np.cos(angle))
    return {"heading_deg": float(np.degrees(heading)), "friction": float(found), "of_true": float(found / friction)}


def creep(make: Make, friction: float) -> dict:
    """Pulled with .9 of what makes it slide: it should stay, mm/s."""
    world = make(CUBE)
    world.step(0.3)
    world.pull(np.array([0.9 * friction * CUBE.mass * GRAVITY, 0.0, 0.0]))
    world.step(0.5)
    before = world.pose().position[0]
    world.step(2.0)
    return {"mm_per_s": 1e3 * float(world.pose().position[0] - before) / 2.0}


def push_off_centre(make: Make, offset: float = 0.02, distance: float = 0.06) -> dict:
    """Pushed slowly 2 cm beside its middle over 6 cm: how far it turns, degrees. No theory: it depends on where the box
    bears (31 for a pressed patch, 17 for its corners), which no simulator models."""
    start = np.array([-CUBE.half_size[0] - TIP_RADIUS - 1e-4, offset, CUBE.half_size[2]])
    world = make(BoxOnTable(CUBE.half_size, CUBE.mass, tuple(start)))
    world.step(0.3)
    _lead_along(world, start, [distance, 0.0, 0.0], 3.0, 600)
    return {"turned_deg": abs(float(np.degrees(_turn(world))))}


def tip_over(make: Make) -> dict:
    """Pulled high up, a box tips about its edge before it slides: the least force that does, over rigid theory's."""
    height = 0.04  # m above its centre
    theory = TALL.mass * GRAVITY * TALL.half_size[0] / (TALL.half_size[2] + height)

    def tips(force: float) -> bool:
        world = make(TALL)
        world.step(0.3)
        world.pull(np.array([force, 0.0, 0.0]), height)
        world.step(0.6)
        return matrix_from_quaternion(world.pose().quaternion)[2, 2] < np.cos(0.1)

    least = _bracket_tipping(tips, 0.5 * theory, 1.5 * theory)[1]
    return {"force_n": least, "of_theory": least / theory}


def bench(make: Make, make_engine: MakeEngine, friction: float) -> dict:
    """All of it, for one engine and its contact: its box world, and its whole scene."""
    return {
        "press": press(make),
        "drag": drag(make),
        "drag_off_centre": drag_off_centre(make),
        "slide": [slide(make, friction, np.radians(h)) for h in HEADINGS],
        "creep": creep(make, friction),
        "push_off_centre": push_off_centre(make),
        "tip_over": tip_over(make),
        "tip_off_wall": tip_off_wall(make),
        "without_touch": {name: hand_bench.draw_along_wall(make_engine, name) for name in hand_bench.DIRECTIONS},
        "without_touch_rough": hand_bench.draw_along_wall(make_engine, "both", ROUGH),
    }


THEORY: dict[str, float | str] = {
    "finger into card at 20 N, mm": 0.0,
    "card into table at 20 N, mm": 0.0,
    "card under a finger that is drawn 30 mm, mm": 30.0,
    "card turned by a finger 20 mm beside its middle that is drawn 60 mm, degrees": 0.0,
    "friction along an edge, over the coefficient": 1.0,
    "friction along the diagonal, over the coefficient": 1.0,
    "friction at worst, over the coefficient": 1.0,
    "creep at .9 of the load that slides, mm/s": 0.0,
    "force that tips, over theory's": 1.0,
    "pushed 20 mm beside its middle over 60 mm, degrees": "17 (corners) to 31 (patch)",
    "finger ahead of the middle of a box that is drawn along a wall until it tips, mm": 5.0,
    "steps without touch while a leaned hand draws a box along a wall, share": 0.0,
    "the same aslant along a wall of friction 0.5, share": 0.0,
}
"""What a rigid box does, question by question."""


def figures(answer: dict) -> dict[str, float]:
    """The summary of what `bench` gives, question by question as in THEORY."""
    pressed = next(row for row in answer["press"]["rows"] if row["force"] == 20.0)
    friction = {round(row["heading_deg"]): row["of_true"] for row in answer["slide"]}
    values = (
        pressed["finger_mm"],
        pressed["table_mm"],
        answer["drag"]["followed_mm"],
        answer["drag_off_centre"]["turned_deg"],
        friction[0],
        friction[45],
        max(friction.values(), key=lambda share: abs(share - 1)),
        answer["creep"]["mm_per_s"],
        answer["tip_over"]["of_theory"],
        answer["push_off_centre"]["turned_deg"],
        answer["tip_off_wall"]["ahead_mm"],
        max(answer["without_touch"].values()),
        answer["without_touch_rough"],
    )
    return dict(zip(THEORY, values, strict=True))


def mujoco(contact: ContactModel, timestep: float = 0.002) -> Make:
    """Makes worlds of MuJoCo with this contact."""
    return partial(MujocoBoxWorld, contact=contact, timestep=timestep)


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--contact", choices=sorted(CONTACTS), default="soft")
    contact = find_contact(parser.parse_args(arguments).contact)
    answer = bench(mujoco(contact), partial(MujocoEngine, contact=contact), contact.table)
    print(json.dumps({"engine": "mujoco", "contact": contact.name, **answer}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
