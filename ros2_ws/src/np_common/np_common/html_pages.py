"""Shared parts of reports: the style of plots, a plot as SVG text, and a page from a package's template."""

from __future__ import annotations

import io
from contextlib import AbstractContextManager

import jinja2
import matplotlib
from matplotlib.figure import Figure

_STYLE = {
    "font.size": 9,
    "font.family": "sans-serif",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "svg.fonttype": "none",
    "svg.hashsalt": "np",  # the same plot is the same text
}


def style() -> AbstractContextManager:
    """The context in which plots are drawn and written."""
    return matplotlib.rc_context(_STYLE)


def svg(figure: Figure) -> str:
    """A figure as SVG text that stands in a page."""
    text = io.StringIO()
    with style():
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()[text.getvalue().index("<svg") :]


def page(package: str, template: str = "report.html.j2", **values: object) -> str:
    """A template of a package's data, filled in. Raises jinja2.UndefinedError for a value left out."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(package, "data"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(values)
