"""clock.html: offset and drift of two streams on one screen, with what they rest on."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from np_common.html_pages import page, style, svg
from sim2real.report.clock_words import SCOPE
from sim2real.task.clock import Clock

BLUE, GREY = "#1f5fa8", "#b0b7c3"


def render(clock: Clock, found: dict) -> str:
    """The page as text. found: `clock_words.document` of it."""
    return page(
        "sim2real", "clock.html.j2", found=found, frames=found["frames"].values(), scope=SCOPE, plot=plot(clock)
    )


def plot(clock: Clock) -> str:
    """Where the angular speeds agree, and the offset of the whole recording beside that of its parts, as SVG text."""
    with style():
        figure = Figure(figsize=(9.6, 3.0), layout="constrained")
        left, right = figure.subplots(1, 2)
        offsets, agreement = clock.agreement
        left.plot(1e3 * offsets, agreement, color=BLUE)
        left.set_xlabel("offset (ms)")
        left.set_ylabel("correlation of angular speeds")
        for rival in clock.rivals:
            left.axvline(1e3 * rival, color=GREY, ls=":")
        values = [("all", clock.offset), *zip(("first third", "second third", "last third"), clock.thirds)]
        values += zip(("quick turns", "slow turns"), clock.paces)
        shown = [(name, value) for name, value in values if value]
        for row, (_, value) in enumerate(shown):
            right.plot([1e3 * value.low, 1e3 * value.high], [row, row], color=BLUE if not row else GREY, lw=3)
            right.plot(1e3 * value.value, row, "o", color=BLUE)
        right.set_yticks(np.arange(len(shown)), [name for name, _ in shown])
        right.invert_yaxis()
        right.set_xlabel("offset with its 95 % interval (ms)")
        return svg(figure)
