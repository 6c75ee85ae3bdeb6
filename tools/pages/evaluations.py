"""docs/results/evaluations.md and what other pages take from it: the cells of `make evaluate`, from the evaluation_*.json files beside it."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from statistics import median

from pages.markdown import head, paragraph, rate, table

TASKS = {
    "card": "slide",
    "bump": "tumble a cube onto or over a step",
    "wall": "draw a box onto a wall",
}
CELLS = {
    "MuJoCo, true corners": "truth",
    "MuJoCo, camera": "camera",
    "PhysX, true corners": "truth_physx",
    "PhysX, camera": "camera_physx",
}
INTRODUCTION = """An episode succeeds if the object's true pose is within 1 cm of the goal (card and bump: and within 0.1 rad) when
the graph declares success. Intervals are 95 % Wilson intervals. Contacts are hard in both engines. PhysX was developed side by side with former
policies; these policies were trained and chosen without it, and their seeds there had not been played. Camera cells have no image latency, blur,
calibration error or change of light: images are rendered at the tick that they are stamped with, by the renderer family of the training images."""
STRANGER = """The figures of PhysX are of version 3 of the engine ([contacts](static_bench.md)). MuJoCo alone chooses a release: these policies were
released before that version, and no graph had played them in it. Its fingertips give way across the finger as well as along it. The wall depends on
that: without it a leaned hand hops on the box. So a real fingertip has to be of rubber that gives way and damps. MuJoCo's own figures do not hang on its step: with 0.5 ms in place of 2 ms 20 of 20 episodes of the wall and of the
bump succeed (`finer_steps` in the data of true corners), with raw peaks of at most 21 and 41 N."""


def read(folder: Path) -> Iterator[tuple[str, str, str, Mapping]]:
    """Task, name of the cell, file and data of each evaluation in `folder`; a cell that was not played has no file."""
    for task in TASKS:
        for name, cell in CELLS.items():
            file = folder / f"evaluation_{task}_{cell}.json"
            if file.exists():
                yield task, name, file.name, json.loads(file.read_text(encoding="utf-8"))


def successes(data: Mapping) -> str:
    """Successes of episodes of a cell."""
    return f"{sum(e['success'] for e in data['per_episode'])} of {len(data['per_episode'])}"


def summary(folder: Path) -> str:
    """Table of successes by task and cell."""
    found = {(task, name): successes(data) for task, name, _, data in read(folder)}
    rows = (
        (f"{task}: {motion}", *(found.get((task, name), "not played") for name in CELLS))
        for task, motion in TASKS.items()
    )
    return "\n" + table(("task", *CELLS), rows)


def reflex_stops(folder: Path, tasks: Collection[str], engine: str) -> str:
    """Episodes of these tasks in an engine, MuJoCo or PhysX, that reach the driver's thresholds, as `N of M`."""
    cells = [data for task, name, _, data in read(folder) if task in tasks and name.startswith(engine)]
    return f"{sum(c['reflex_stops']['40'] for c in cells)} of {sum(c['force_episodes'] for c in cells)}"


def forces_by_truth(folder: Path) -> str:
    """Table of the forces of episodes with true corners."""
    rows = [
        (task, name.partition(",")[0])
        + tuple(f"{data[kind]['median']:.0f} / {data[kind]['max']:.0f}" for kind in ("raw_peak_n", "force_n"))
        + tuple(
            f"{n} of {data['force_episodes']}"
            for n in (data["reflex_stops"]["40"], data["reflex_stops"]["25"], data["peak_by"].get("housing", 0))
        )
        for task, name, _, data in read(folder)
        if name.endswith("true corners")
    ]
    header = ("task", "engine", "raw peak, median / largest, N", "filtered, median / largest, N")
    counts = ("beyond the driver's thresholds", "beyond 25 N and lower torques", "hand's housing presses hardest")
    return "\n" + table((*header, *counts), rows)


def page(folder: Path) -> str:
    """Text of the page."""
    cells = list(read(folder))
    found = {(task, name): f"[{successes(data)}]({file})" for task, name, file, data in cells}
    by_task = [(task, *(found.get((task, name), "not played") for name in CELLS)) for task in TASKS]
    rows = [_row(*cell) for cell in cells]
    commands = "\n".join(f"{data['command']}  # {data['date']}, {data['settings']['revision']}" for *_, data in cells)
    failed = [
        (task, name, e["episode"], e["declared"], e["reason"], _mm(e["distance"]), e["angle"])
        for task, name, _, data in cells
        for e in data["per_episode"]
        if not e["success"]
    ]
    limits = [
        (task, name, *(data["limit_share"][kind][q] for kind in ("velocity", "torque") for q in ("median", "q99")))
        for task, name, _, data in cells
    ]
    return "".join(
        [
            head("Evaluations through the graph", "evaluation_*.json", INTRODUCTION),
            table(("task", *CELLS), by_task),
            f"\n{paragraph(STRANGER)}\n\n",
            table(
                ("task", "cell", "success", "median distance, mm", "angle, rad", "time, s", "declared wrongly"), rows
            ),
            "\n## Commands, dates and revisions\n\n```\n",
            commands,
            "\n```\n\n## Limits\n\nLargest share of a joint's limit in an episode. Torque is the commanded one.\n\n",
            table(("task", "cell", "speed, median", "99 %", "torque, median", "99 %"), limits),
            *_forces(cells),
            "\n## Episodes that failed\n\n",
            table(("task", "cell", "episode", "declared", "reason", "distance, mm", "angle, rad"), failed),
        ]
    )


def _forces(cells: list[tuple[str, str, str, Mapping]]) -> Iterator[str]:
    rows = [
        (task, name, *(data[kind][q] for kind in ("force_n", "raw_peak_n") for q in ("median", "q99")))
        + tuple(f"{data['reflex_stops'][n]} of {data['force_episodes']}" for n in ("40", "25"))
        for task, name, _, data in cells
        if "force_n" in data  # a cell that was played without the force estimate has none
    ]
    if rows:
        yield "\n## Forces\n\nLargest external force of an episode, N: filtered over 10 ms, and the raw peak of the contact solver.\n\n"
        yield table(
            ("task", "cell", "filtered, median", "99 %", "raw, median", "99 %", "stops at 40 N", "at 25 N"), rows
        )


def _row(task: str, name: str, file: str, data: Mapping) -> tuple:
    ended = [e for e in data["per_episode"] if e["distance"] is not None]
    middle = (median(e[key] for e in ended) for key in ("distance", "angle", "duration"))
    distance, angle, time = middle
    return task, name, rate(data["success"], data["ci95"]), _mm(distance), angle, time, data["declared_wrongly"]


def _mm(distance: float | None) -> float | None:
    return None if distance is None else 1e3 * distance
