"""docs/reference/objects.md: the objects, what stands around them and what they look like, from np_description."""

from __future__ import annotations

from math import degrees, pi

from np_description.domains import DOMAINS, Region, Task
from np_description.keypoints import CORNERS
from np_description.objects.spec import ObjectSpec
from np_description.objects.table import BASELINES, SURFACES, TRIES, rows_of
from np_description.scene import CORNER_COLOURS
from pages.markdown import head, paragraph, table

INTRODUCTION = f"""The 21 objects of the paper's Table III (`make evaluate DOMAIN=bump OBJECT=sponge`). The paper gives masses, surfaces,
which objects are not rigid, and the successes of {TRIES} tries with a real robot. It gives no sizes: every row has the size of its task's default
object. Frictions, stiffnesses and clearances are estimates with their source. All frictions are inside the range of the training.
`make table3` plays all rows and compares them with the paper. Positions are of the object's middle in the base frame: x forwards,
y to the robot's left, z up from the table. See also [your own object](../guide/your_own_object.md)."""

LOOKS = """Each object consists of eight coloured blocks, one a corner. The released detectors distinguish corners by these colours, so a real object
must be painted or printed in them (`ros2 run np_perception object_sheet --domain card --out card.pdf` prints the faces to scale). An object in one
colour is not found. An object with permuted colours is found with a wrong pose and high scores. Table, obstacles and light vary in training.
RGB values are 0 to 255. Corners are named by their sign along the object's x, y and z. Printed colours before a real camera have not been tried."""

PARTS = """
## Objects that are not rigid

Keypoints and `object_pose` describe the object's core. In both engines the other parts are bodies that slide on the core along one
axis each. A soft object has a plate on each face, on a critically damped spring, with a hard stop at the end of its travel. Loose contents
slide along each axis with clearance and Coulomb friction until a stop; they do not rotate. Mass, centre of mass and inertia
are the object's while every part is centred. The step of 2 ms limits the springs to 150 rad/s, so a blow meets more inertia than a real sponge has.
Evaluations count penetration of a soft face only beyond its travel.
"""

SCENARIOS = """Each task has three fixed scenarios (`--scenario 1` of `evaluate`, `scenario:=1` of the launch file). The pictures show the start
in the camera's view and the goal as an outline. The paper prints no poses; these are ours. Starts scatter by 2 mm and 0.03 rad, determined by
seed and episode."""


def softness(spec: ObjectSpec) -> str:
    """What of an object is not rigid, in words; "" for nothing."""
    words = []
    if spec.compliance:
        words.append(f"soft: {spec.compliance.stiffness:g} N/m along z, {1e3 * spec.compliance.travel:g} mm a face")
    if spec.contents:
        inside = spec.contents
        gaps = ", ".join(f"{1e3 * gap:g} mm along {axis}" for axis, gap in zip("xyz", inside.clearance) if gap)
        words.append(f"loose: {1e3 * inside.mass:g} g, either way {gaps}, friction {inside.friction:g}")
    return "; ".join(words)


def _span(low: float, high: float) -> str:
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def _turn(yaw: tuple[float, float]) -> str:
    return "any" if yaw == (-pi, pi) else f"{_span(*map(degrees, yaw))} degrees"


def _face(region: Region) -> str:
    if region.quarter_turns:
        return "any face"
    return (
        f"the face that a pitch of {degrees(region.pitch):g} degrees brings down" if region.pitch else "its lower face"
    )


def _place(name: str, region: Region, turned: str) -> tuple[str, ...]:
    return name, _span(*region.x), _span(*region.y), f"{1e3 * region.surface:g}", turned, _face(region)


def places(domain: Task) -> str:
    """What stands fixed on the table, and where the object begins and is to go, in the base frame."""
    fixed = [
        f"A fixed box, {' x '.join(f'{2e3 * half:g}' for half in box.half_size)} mm, stands on the table, its middle at x {box.centre[0]:g},"
        f" y {box.centre[1]:g} m.\n\n"
        for box in domain.obstacles
    ]
    relative = f"{_turn(domain.goal_yaw)} from the start's" if domain.goal_yaw else None
    rows = [
        _place("start", domain.start, _turn(domain.start.yaw)),
        *(_place("goal", region, relative or _turn(region.yaw)) for region in domain.goals),
    ]
    return "".join(fixed) + table(("", "x, m", "y, m", "on a surface at z, mm", "yaw", "rests on"), rows) + "\n"


def page() -> str:
    """The page."""
    parts = [head("Objects", "np_description", INTRODUCTION)]
    for name in DOMAINS:
        rows, base = rows_of(name).values(), BASELINES[name]
        size = " x ".join(f"{1e3 * edge:g}" for edge in next(iter(rows)).spec.size)
        parts.append(f"## {name}\n\n{size} mm\n\n{places(DOMAINS[name])}")
        cells = (
            (f"`{r.spec.name}`", f"{1e3 * r.spec.mass:.3g}", r.spec.surface.name, softness(r.spec), str(r.successes))
            for r in rows
        )
        parts.append(table(("object", "mass, g", "surface", "not rigid", f"the paper's, of {TRIES}"), cells))
        fixed = f", limits at zeta* from the first step {base.fixed_limits}" if base.fixed_limits else ""
        parts.append(
            f"\nThe paper's baselines, with `default`: operational space control {base.operational_space}{fixed}.\n\n"
        )
    parts.append(f"## What they look like\n\n{paragraph(LOOKS)}\n\n")
    cells = (
        (
            str(number),
            " ".join("+" if sign > 0 else "-" for sign in corner),
            " ".join(f"{255 * part:.0f}" for part in colour),
        )
        for number, (corner, colour) in enumerate(zip(CORNERS, CORNER_COLOURS))
    )
    parts.append(table(("keypoint", "x y z", "red green blue"), cells))
    parts.append("\n## Surfaces\n\n")
    cells = (
        (f"`{s.name}`", f"{s.finger.coefficient:g}", s.finger.source, f"{s.table.coefficient:g}", s.table.source)
        for s in SURFACES.values()
    )
    parts.append(table(("surface", "with a fingertip", "source", "with table and obstacles", "source"), cells))
    parts.append(PARTS)
    parts.append(f"\n## Scenarios\n\n{paragraph(SCENARIOS)}\n")
    parts += [
        f"\n![{name}: start and goal of three scenarios](../guide/images/scenarios_{name}.jpg)\n" for name in DOMAINS
    ]
    return "".join(parts)
