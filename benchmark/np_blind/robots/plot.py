"""Pictures of withheld robots: success in PhysX before and after, and what the simulator predicted of it. Need matplotlib, else ImportError."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from np_common.intervals import wilson_interval

STAGES = (("nominal", "without the gap", "tab:gray"), ("before", "with it", "tab:red"), ("adopted", "kept", "tab:blue"))
OF_KEPT = {"before": "patched", "corrected": "patched_corrected", "trained": "patched_after"}


def plot_robots(rows: Sequence[Mapping], path: Path) -> None:
    """Rows of `robots.set` that came to an end: success with 95 % intervals, and crosses where the patched simulator expected it."""
    from matplotlib.figure import Figure  # slow, and no part of a lean install

    done = [row for row in rows if "adopted" in row.get("engine", {})]
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    axes = figure.subplots()
    for number, (name, label, colour) in enumerate(STAGES):
        at = np.arange(len(done)) + 0.22 * (number - 1)
        each = [row["engine"][name] for row in done]
        share = np.array([np.mean(one) for one in each])
        low, high = np.array([wilson_interval(sum(one), len(one)) for one in each]).T
        error = np.maximum([share - low, high - share], 0.0)
        axes.errorbar(at, share, error, fmt="o", ms=4, lw=1, color=colour, label=label)
        if name == "nominal":
            continue
        stages = ["patched" if name == "before" else OF_KEPT[row["kept"]] for row in done]
        expected = [row["success"][key]["value"] for row, key in zip(done, stages)]
        axes.plot(at, expected, "x", ms=6, color=colour, label=f"{label}, as predicted")
    axes.set_xticks(range(len(done)), [f"{row['robot']}\n{row['domain']}" for row in done])
    axes.set(xlabel="robot", ylabel="success in PhysX", ylim=(0, 1.03))
    axes.legend(fontsize=7, loc="lower left", ncols=3)
    figure.savefig(path)


def plot_matrix(table: Sequence[Mapping], path: Path) -> None:
    """Success of every policy on every robot: PhysX over both simulators."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.8, 3.9), layout="constrained")
    for axes, side in zip(figure.subplots(1, 2, sharey=True), ("nominal", "patched")):
        for domain, colour in (("wall", "tab:blue"), ("bump", "tab:orange")):
            pairs = np.array([(row[side], row["engine"]) for row in table if row["domain"] == domain]).reshape(-1, 2)
            axes.plot(*pairs.T, "o", ms=4, alpha=0.5, color=colour, label=domain)
        axes.plot([0, 1], [0, 1], lw=0.7, color="gray")
        axes.set(title=f"{side} simulator", xlabel="success predicted", aspect="equal")
    figure.axes[0].set_ylabel("success in PhysX")
    figure.axes[0].legend(fontsize=7)
    figure.savefig(path)
