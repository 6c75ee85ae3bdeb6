"""Curves of training runs, drawn from their logs, and when a success is reached for good."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from np_common.html_pages import style
from np_description.force_reflex import FORCE_REFLEX
from np_training.ppo.curriculum import STAGES
from np_training.reports.words import task_label

GROUPS = ("tips", "goal")  # of a domain's own tasks (np_training.tasks.breakdown), by the beginning of their names
LEAST_PRACTICE = 0.05  # share of practice below which its kinds have too few episodes for a rate
WINDOW = 10  # iterations that a success has to last

Rows = list[dict[str, float]]


def column(rows: Rows, name: str) -> np.ndarray:
    """A column (n,) of a log, NaN where a row does not have it."""
    return np.array([row.get(name, np.nan) for row in rows])


def find_success(rows: Rows, success: float) -> dict[str, float] | None:
    """Policy steps and wall seconds after which the mean of WINDOW iterations first was at least `success`,
    or None."""
    values = column(rows, "success")
    if len(values) < WINDOW:
        return None
    hits = np.flatnonzero(np.convolve(values, np.full(WINDOW, 1 / WINDOW), "valid") >= success)
    if not len(hits):
        return None
    row = rows[hits[0] + WINDOW - 1]
    return {"steps": row["steps"], "seconds": row["elapsed"], "stage": row["stage"]}


def draw_curves(rows: Rows) -> Figure:
    """Success, stage, forces, reward terms, episodes, contacts, optimisation and speed against policy steps."""
    with style():
        figure = Figure(figsize=(11, 14), layout="constrained")
        axes = figure.subplots(4, 2, sharex=True).flat
        panels = (_success, _forces, _rewards, _ends, _contacts, _touches, _optimisation, _speed)
        for ax, draw in zip(axes, panels):
            draw(ax, rows)
        for ax in figure.axes[6:8]:
            ax.set_xlabel("million policy steps")
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format of the file's ending."""
    with style():
        figure.savefig(path, dpi=110)


def _lines(ax: Axes, rows: Rows, names: dict[str, str], scale: float = 1.0) -> None:
    for name, label in names.items():
        values = scale * column(rows, name)
        if np.isfinite(values).any():
            ax.plot(column(rows, "steps") / 1e6, values, label=label, linewidth=1)
    if ax.lines:  # above the axes: nothing is hidden behind it
        place = {"loc": "lower left", "bbox_to_anchor": (0, 1), "ncols": 3, "frameon": False}
        ax.legend(fontsize=7, handlelength=1.2, columnspacing=1, borderpad=0, **place)


def _success(ax: Axes, rows: Rows) -> None:
    names = sorted({name for row in rows for name in row if name.startswith("success_") and name != "success_mean"})
    own = [name for name in names if name[len("success_") :].startswith(GROUPS)]
    steps, practised = column(rows, "steps") / 1e6, column(rows, "practice") > LEAST_PRACTICE
    # Each kind of practice in grey, behind: how they rise matters more than which is which.
    for number, name in enumerate(name for name in names if name not in own):
        values = np.where(practised, column(rows, name), np.nan)
        label = None if number else "practice, each kind"
        ax.plot(steps, values, color="0.82", linewidth=0.6, label=label)
    _lines(ax, rows, {"success": "all", **{name: task_label(name[len("success_") :]) for name in own}})
    ax.set(ylabel="success of ended episodes", ylim=(0, 1.02))
    stage = ax.twinx()
    stage.step(steps, column(rows, "stage"), color="0.5", where="post", linewidth=1)
    stage.set_ylabel(f"stage, grey (above {STAGES}: randomised)", color="0.4")
    stage.set_ylim(0, max(STAGES + 1.3, 1.05 * column(rows, "stage").max()))
    stage.grid(False)


def _forces(ax: Axes, rows: Rows) -> None:
    _lines(ax, rows, {"force_median": "median", "force_q99": "99 %", "force_max": "largest"})
    ax.axhline(FORCE_REFLEX.force, color="0.5", linewidth=0.8)  # where the robot stops
    ax.set_yscale("log")
    ax.set(ylabel="largest filtered force of an episode, N")


def _touches(ax: Axes, rows: Rows) -> None:
    _lines(
        ax,
        rows,
        {"touching": "robot touches the object", "bare": "of it housing or links", "pressed": "stopped by force"},
    )
    ax.set(ylabel="share", ylim=(0, 1.02))


def _rewards(ax: Axes, rows: Rows) -> None:
    names = sorted({name for row in rows for name in row if name.startswith("reward_")})
    _lines(ax, rows, {name: name[len("reward_") :].replace("_", " ") for name in names})
    ax.set_yscale("symlog", linthresh=1e-3)
    ax.set(ylabel="reward a step, scaled")


def _ends(ax: Axes, rows: Rows) -> None:
    _lines(ax, rows, {"length": "length, steps"})
    _lines(ax, rows, {"end_distance": "distance at the end, mm"}, scale=1e3)
    _lines(ax, rows, {"end_angle": "angle at the end, deg"}, scale=180 / np.pi)
    ax.set(ylabel="episodes", ylim=(0, None))


def _contacts(ax: Axes, rows: Rows) -> None:
    _lines(
        ax,
        rows,
        {
            "pre_feasible": "feasible contacts",
            "lost": "objects lost",
            "stopped": "stopped by the reflex",
            "practice": "practice",
        },
    )
    ax.set(ylabel="share", ylim=(0, 1.02))


def _optimisation(ax: Axes, rows: Rows) -> None:
    _lines(
        ax,
        rows,
        {
            "std": "deviation, post-contact",
            "pre_std": "deviation, pre-contact",
            "lr": "learning rate",
            "kl": "KL divergence",
            "value_loss": "value loss",
        },
    )
    ax.set_yscale("log")
    ax.set(ylabel="optimisation")


def _speed(ax: Axes, rows: Rows) -> None:
    _lines(ax, rows, {"steps_per_second": "policy steps a second"})
    ax.set(ylabel="throughput", ylim=(0, None))
