"""docs/guide/images/setup.svg: base, workspaces, fixed boxes and camera to scale, from np_description."""

from __future__ import annotations

import numpy as np

from np_description.camera import CAMERA
from np_description.domains import BUMP, CARD, WALL, Task

SCALE = 0.5  # drawing units a millimetre
LEFT, TOP, SIDE = (
    330.0,
    260.0,
    830.0,
)  # drawing units: base in the top view, and the height of the table in the side view
COLOURS = {CARD.name: "#4878a8", BUMP.name: "#b86a2c", WALL.name: "#4a8a4a"}


def _mm(value: float) -> str:
    return f"{1e3 * value:g}"


def _text(x: float, y: float, text: str, anchor: str = "middle") -> str:
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" stroke="none">{text}</text>'


def _rectangle(x: float, y: float, width: float, height: float, style: str) -> str:
    return f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" {style}/>'


def _dimension(x: float, to: float, y: float, text: str) -> list[str]:
    """A horizontal dimension line with its text above."""
    ends = [f'<line x1="{end:g}" y1="{y - 5:g}" x2="{end:g}" y2="{y + 5:g}"/>' for end in (x, to)]
    return [f'<line x1="{x:g}" y1="{y:g}" x2="{to:g}" y2="{y:g}"/>', *ends, _text((x + to) / 2, y - 5, text)]


def _from_above(task: Task) -> list[str]:
    """Workspace and fixed boxes of a task, from above: x of the base to the right, y up."""
    colour, (x0, x1), (y0, y1) = COLOURS[task.name], task.workspace_x, task.workspace_y
    unit = 1e3 * SCALE
    parts = [
        _rectangle(
            LEFT + x0 * unit,
            TOP - y1 * unit,
            (x1 - x0) * unit,
            (y1 - y0) * unit,
            f'fill="none" stroke="{colour}" stroke-dasharray="6 4"',
        )
    ]
    for box in task.obstacles:
        (x, y, _), (a, b, _) = box.centre, box.half_size
        style = f'fill="{colour}" fill-opacity="0.35" stroke="{colour}"'
        parts.append(_rectangle(LEFT + (x - a) * unit, TOP - (y + b) * unit, 2 * a * unit, 2 * b * unit, style))
    return parts


def _from_the_side(task: Task) -> list[str]:
    """Fixed boxes of a task, seen along y."""
    colour, unit, parts = COLOURS[task.name], 1e3 * SCALE, []
    for box in task.obstacles:
        (x, _, z), (a, _, c) = box.centre, box.half_size
        style = f'fill="{colour}" fill-opacity="0.35" stroke="{colour}"'
        parts.append(_rectangle(LEFT + (x - a) * unit, SIDE - (z + c) * unit, 2 * a * unit, 2 * c * unit, style))
    return parts


def _legend() -> list[str]:
    lines = []
    for row, task in enumerate((CARD, BUMP, WALL)):
        boxes = "; ".join(
            f"box {' x '.join(_mm(2 * half) for half in box.half_size)}, middle at x {_mm(box.centre[0])}, y {_mm(box.centre[1])}"
            for box in task.obstacles
        )
        y = 945 + 20 * row
        lines += [_rectangle(20, y - 10, 14, 10, f'fill="{COLOURS[task.name]}" stroke="none"')]
        lines += [_text(42, y, f"{task.name}: dashed, where the object may be; {boxes or 'no fixed box'}", "start")]
    return lines


def drawing() -> str:
    """The text of the SVG; lengths in it are millimetres."""
    unit = 1e3 * SCALE
    camera_x, _, camera_z = CAMERA.position
    ahead_x, _, ahead_z = np.asarray(CAMERA.rotation)[:, 2]
    look = round(camera_x - camera_z * ahead_x / ahead_z, 6)  # x at which the optical axis meets the table
    x, height = LEFT + camera_x * unit, SIDE - camera_z * unit
    tasks = (CARD, BUMP, WALL)
    parts = [
        _text(LEFT, 24, "from above"),
        *(part for task in tasks for part in _from_above(task)),
        f'<circle cx="{LEFT:g}" cy="{TOP:g}" r="40" fill="#ddd"/>',
        _text(LEFT, TOP + 4, "base"),
        f'<line x1="{LEFT + 40:g}" y1="{TOP:g}" x2="{LEFT + 90:g}" y2="{TOP:g}" marker-end="url(#tip)"/>',
        _text(LEFT + 66, TOP - 8, "x"),
        f'<line x1="{LEFT:g}" y1="{TOP - 40:g}" x2="{LEFT:g}" y2="{TOP - 90:g}" marker-end="url(#tip)"/>',
        _text(LEFT - 12, TOP - 70, "y"),
        _rectangle(x - 8, TOP - 22, 24, 44, 'fill="#555"'),
        _text(x + 4, TOP + 40, "camera"),
        *_dimension(LEFT, x, 480, _mm(camera_x)),
        _text(LEFT, 530, "from the side"),
        f'<line x1="{LEFT - 90:g}" y1="{SIDE:g}" x2="{x + 80:g}" y2="{SIDE:g}" stroke-width="3"/>',
        _text(LEFT - 120, SIDE + 5, "table"),
        _rectangle(LEFT - 40, SIDE - 70, 80, 70, 'fill="#ddd"'),
        _text(LEFT, SIDE - 30, "base"),
        *(part for task in tasks for part in _from_the_side(task)),
        _rectangle(x - 10, height - 10, 28, 20, 'fill="#555"'),
        f'<line x1="{x:g}" y1="{height:g}" x2="{LEFT + look * unit:g}" y2="{SIDE:g}" stroke-dasharray="3 3"/>',
        f'<line x1="{x + 40:g}" y1="{height:g}" x2="{x + 40:g}" y2="{SIDE:g}"/>',
        _text(x + 46, (height + SIDE) / 2, _mm(camera_z), "start"),
        *_dimension(LEFT, LEFT + look * unit, SIDE + 30, _mm(look)),
        *_legend(),
    ]
    body = "\n".join(parts)
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 850 1000" font-family="sans-serif" font-size="14" stroke-linecap="round">\n'
        "<!-- Written by `make docs` from np_description: do not edit. -->\n"
        '<defs><marker id="tip" markerWidth="8" markerHeight="8" refX="6" refY="3" orient="auto"><path d="M0,0 L6,3 L0,6 z"/></marker></defs>\n'
        f'<rect width="850" height="1000" fill="white"/>\n<g stroke="#333" fill="#222">\n{body}\n</g>\n</svg>\n'
    )
