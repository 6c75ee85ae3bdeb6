"""The plot of an evaluation, as SVG text."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from np_common.html_pages import style, svg
from np_description.domains import Domain
from np_evaluation.scoring import Result
from np_record.report.plots import WIDTH


def results_plot(results: list[Result], domain: Domain) -> str:
    """Where the object ended against the tolerance, and how long the episodes took, of an evaluation."""
    whole = [result for result in results if result.distance is not None]
    with style():
        figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
        ends, times = figure.subplots(1, 2)
        for success, colour, label in ((True, "#2f8f3a", "success"), (False, "#a8461f", "failure")):
            chosen = [result for result in whole if result.success == success]
            ends.scatter(
                [100 * r.distance for r in chosen],
                [np.degrees(r.angle) for r in chosen],
                s=14,
                color=colour,
                label=f"{label}: {len(chosen)}",
            )
        ends.axvline(100 * domain.tolerance_position, color="0.5", ls="--", lw=1)
        if domain.tolerance_angle is not None:
            ends.axhline(np.degrees(domain.tolerance_angle), color="0.5", ls="--", lw=1)
        ends.set(xlabel="distance at the end (cm)", ylabel="angle at the end (deg)", xlim=(0, None), ylim=(0, None))
        ends.legend(frameon=False)
        times.hist([result.duration for result in whole], bins=20, color="#1f5fa8")
        times.set(xlabel="simulated time (s)", ylabel="episodes", xlim=(0, None))
        return svg(figure)
