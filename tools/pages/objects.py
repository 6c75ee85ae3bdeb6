"""docs/reference/objects.md: the objects, what stands around them and what they look like, from np_description."""

from __future__ import annotations

from math import degrees, pi

from np_description.domains import DOMAINS, Domain, Region
from np_description.keypoints import CORNERS
from np_description.objects.spec import ObjectSpec
from np_description.objects.table import BASELINES, SURFACES, TRIES, rows_of
from np_description.scene import CORNER_COLOURS
from pages.markdown import head, paragraph, table

INTRODUCTION = f"""The 21 objects of the paper's Table III: `make evaluate DOMAIN=bump OBJECT=sponge`. Masses, surfaces and which are not
rigid are the paper's, and so are the successes of its policy, of {TRIES} tries with the real robot. It prints no sizes: every row
has the size of its domain's own object. Frictions, and how soft and how loose things are, are estimates with their source. `default` is the
domain's own object, unchanged. All of them beside the paper's successes: `make table3`
(`CONTACTS=2`: a contact may be chosen twice; `ARGS="--domains wall --objects sponge --scenarios 1 --tries 5"`: less of it). Places are of the
object's middle, in the base frame: x forwards, y to the robot's left, z up from the table. An object of your own: [guide](../guide/your_own_object.md)."""

LOOKS = """Every object consists of eight blocks, one for each corner and half as long as it along each edge, and by their colours the released detectors tell
which corner they see: a real one has to be painted or printed so (`ros2 run np_perception object_sheet --domain card --out card.pdf`: its faces on
A4, to scale). In one colour it is not found, with the colours in another order it is found surely and wrongly
([figures](../decisions/detector.md#another-look)). Table, obstacles and light are of all kinds in training. RGB from 0 to 255, corners by their sign
along the object's x, y, z, which are the base frame's where it lies with all angles 0; what a printed colour is to a real camera has not been tried."""

PARTS = """
## What is not rigid

The object that keypoints and `object_pose` speak of is its core; in both engines the rest are bodies that slide on it along one
axis each. A soft object has a plate on each face, on a spring with critical damping; at the end of its travel it is hard. Edges give
way with their plates, bulges do not exist. What is loose inside slides along each axis with clearance, with Coulomb friction of its
weight, until a stop; it does not turn. Mass, centre of mass and inertia of the whole are the object's while every part is in its
middle. Springs are as fast as a step of 2 ms bears (150 rad/s): a blow meets more inertia than a sponge has, a slow push
the stiffness alone. Evaluations count what goes deeper into a soft face than its travel as penetration.
"""

SCENARIOS = """Three fixed tasks a domain (`--scenario 1` of `evaluate`, `scenario:=1` of the launch file): the start by the camera, the
goal in outline, its corners in their colours. The paper shows its own and prints no poses; these are ours. The start of an
episode scatters by 2 mm and .03 rad, named by seed and episode, where its region leaves room. The pictures:
`python tools/scenarios.py card docs/guide/images/scenarios_card.jpg`."""


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


def _turned(yaw: tuple[float, float]) -> str:
    return "any" if yaw == (-pi, pi) else f"{_span(*map(degrees, yaw))} degrees"


def _face(region: Region) -> str:
    if region.quarter_turns:
        return "any face"
    return (
        f"the face that a pitch of {degrees(region.pitch):g} degrees brings down" if region.pitch else "its lower face"
    )


def _place(name: str, region: Region, turned: str) -> tuple[str, ...]:
    return name, _span(*region.x), _span(*region.y), f"{1e3 * region.surface:g}", turned, _face(region)


def places(domain: Domain) -> str:
    """What stands fixed on the table, and where the object begins and is to go, in the base frame."""
    fixed = [
        f"A fixed box, {' x '.join(f'{2e3 * half:g}' for half in box.half_size)} mm, stands on the table, its middle at x {box.centre[0]:g},"
        f" y {box.centre[1]:g} m.\n\n"
        for box in domain.obstacles
    ]
    relative = f"{_turned(domain.goal_yaw)} from the start's" if domain.goal_yaw else None
    rows = [
        _place("start", domain.start, _turned(domain.start.yaw)),
        *(_place("goal", region, relative or _turned(region.yaw)) for region in domain.goals),
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
