"""view.html: what is off between camera, table and object on one screen, with the corners that it rests on."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from np_common.html_pages import page, style, svg
from sim2real.report.view_words import SCOPE
from sim2real.task.camera.fit import Fit, at_numbers
from sim2real.task.camera.model import Scene
from sim2real.task.camera.parameters import COUNT, PARAMETERS
from sim2real.task.camera.view import View

BLUE, GREY = "#1f5fa8", "#b0b7c3"
ENLARGED = 10.0  # times that what is left is drawn


def render(view: View, found: dict) -> str:
    """The page as text. found: `view_words.document` of it."""
    rows = [
        {
            "said": p.said,
            "value": format(view.bounds[p.name], p.shown).replace("  ", " "),
            "seen": p.name not in view.unseen,
        }
        for p in PARAMETERS
        if p.name in view.bounds
    ]
    plots = plot(view) if view.fit else ""
    return page("sim2real", "view.html.j2", found=found, rows=rows, scope=SCOPE, plot=plots, enlarged=ENLARGED)


def plot(view: View) -> str:
    """Corners in the picture with what is left of them, as believed and in the best explanation, as SVG text."""
    scene = view.scene
    believed = at_numbers(scene, np.zeros(COUNT), view.nominal.poses, view.nominal.scatter)
    with style():
        figure = Figure(figsize=(9.6, 4.6), layout="constrained")
        for axes, fit, colour, title in zip(
            figure.subplots(1, 2),
            (believed, view.fit),
            (GREY, BLUE),
            ("as it is believed to be", "in the best explanation"),
        ):
            _corners(axes, scene, fit, colour)
            axes.set_title(f"{title}, px")
        return svg(figure)


def _corners(axes, scene: Scene, fit: Fit, colour: str) -> None:
    """The picture of all places at once: where corners are seen, and arrows from where they are expected."""
    left = fit.left(scene)[scene.usable]
    start = fit.lines.seen[scene.usable]
    axes.quiver(*start.T, *(ENLARGED * left.T), angles="xy", scale_units="xy", scale=1, color=colour, width=0.003)
    axes.plot(*scene.pixels[scene.usable].T, ".", color="#222", ms=2)
    axes.set_xlim(0, scene.camera.width)
    axes.set_ylim(scene.camera.height, 0)
    axes.set_aspect("equal")
