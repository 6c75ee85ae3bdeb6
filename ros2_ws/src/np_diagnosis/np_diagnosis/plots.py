"""The plots of the report, as SVG text."""

from __future__ import annotations

import io

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from np_diagnosis.diagnosis import Diagnosis

WIDTH = 9.6
BEFORE, AFTER, FLOOR = "#b0b7c3", "#1f5fa8", "#2f8f3a"
_STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "svg.fonttype": "none",
    "svg.hashsalt": "np",
    "font.family": "sans-serif",
}


def gap_plot(diagnosis: Diagnosis) -> str:
    """Held-out RMSE of each joint before and after, with its floor."""
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(WIDTH, 2.6), layout="constrained")
        axes = figure.add_subplot()
        place = np.arange(len(diagnosis.joints))
        axes.bar(
            place - 0.2, [r.before for r in diagnosis.joints], 0.4, color=BEFORE, label="nominal simulator"
        )
        axes.bar(place + 0.2, [r.after for r in diagnosis.joints], 0.4, color=AFTER, label="effects added")
        axes.hlines(
            [r.floor for r in diagnosis.joints], place - 0.45, place + 0.45, color=FLOOR, lw=2, label="floor"
        )
        axes.set_xticks(
            place, [f"{r.joint}\n{r.verdict.replace('_', ' ')}" for r in diagnosis.joints], fontsize=8
        )
        axes.set_ylabel("held-out RMSE (Nm)")
        axes.grid(False, axis="x")
        figure.legend(fontsize=8, loc="outside upper right", ncols=3, frameon=False)
        return _svg(figure)


def residual_plot(diagnosis: Diagnosis) -> str:
    """Residual torque over time, before and held out after."""
    return _grid(diagnosis, np.arange(len(diagnosis.samples)) * 0.01, "sample time (s)", "-", 0.7)


def velocity_plot(diagnosis: Diagnosis) -> str:
    """Residual torque over velocity: what friction looks like."""
    return _grid(diagnosis, None, "velocity (rad/s)", ".", 1.0)


def _grid(diagnosis: Diagnosis, time, label: str, mark: str, size: float) -> str:
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(WIDTH, 4.4), layout="constrained")
        panels = figure.subplots(2, 4).ravel()
        stride = max(1, len(diagnosis.samples) // 1500)
        for j, (axes, result) in enumerate(zip(panels, diagnosis.joints)):
            x = (diagnosis.samples.velocity[:, j] if time is None else time)[::stride]
            for values, colour in ((result.residual_before, BEFORE), (result.residual_after, AFTER)):
                axes.plot(x, values[::stride], mark, color=colour, lw=size, ms=size)
            axes.set_title(result.joint, fontsize=8)
            axes.set_xlabel(label, fontsize=8)
        panels[0].set_ylabel("residual (Nm)")
        panels[4].set_ylabel("residual (Nm)")
        panels[-1].axis("off")
        for text, colour, height in (
            ("nominal simulator", BEFORE, 0.6),
            ("effects added, held out", AFTER, 0.4),
        ):
            panels[-1].text(0.1, height, text, color=colour, weight="bold", transform=panels[-1].transAxes)
        return _svg(figure)


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]
