"""The picture of a table of objects, as SVG text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from np_common.html_pages import style, svg
from np_record.report.plots import WIDTH

_COLOURS = {"card": "#1f5fa8", "bump": "#2f8f3a", "wall": "#a8461f"}


def table_plot(rows: Sequence[Mapping]) -> str:
    """Success of each row with its 95 % interval, beside the paper's."""
    with style():
        figure = Figure(figsize=(WIDTH, 0.8 + 0.24 * len(rows)), layout="constrained")
        axes = figure.subplots()
        for place, row in enumerate(rows):
            if row["episodes"]:
                low, high = row["ci95"]
                axes.plot([low, high], [place, place], color=_COLOURS[row["domain"]], lw=2, alpha=0.5)
                axes.plot(row["success"], place, "o", color=_COLOURS[row["domain"]])
            axes.plot(row["paper_successes"] / row["paper_tries"], place, "x", color="0.2")
        axes.plot([], [], "o-", color="0.5", label="here, 95 %")
        axes.plot([], [], "x", color="0.2", label="the paper, real robot")
        axes.set_yticks(range(len(rows)), [f"{row['domain']}: {row['object']}" for row in rows])
        axes.set(xlabel="success", xlim=(-0.02, 1.02), ylim=(len(rows) - 0.5, -0.5))
        axes.grid(axis="x", alpha=0.3)
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)
        return svg(figure)
