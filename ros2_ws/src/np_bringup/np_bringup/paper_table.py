"""The paper's Table III, played again: 21 objects in three scenarios each, and its two baselines with the default object.

Kim et al., IROS 2023, Table III: five tries in each scenario with a real Panda. Here a try is an episode through the whole graph.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from np_description.objects.choice import DEFAULT
from np_description.objects.scenarios import COUNT
from np_description.objects.table import BASELINES, TRIES, rows_of
from np_record.intervals import wilson_interval
from np_ros.parent import end_with_parent

OURS, OSC, FIXED = "ours", "osc", "fixed_limits"
TITLES = {OURS: "", OSC: "operational space control", FIXED: "limits at zeta* from the first step"}
"""The methods: our policies; the same trained with operational space control; with limits of the residual that never moved."""


@dataclass(frozen=True)
class Setting:
    """What all cells of a table share: engine, source of keypoints, episodes a scenario, seed, folder of the results, and of each
    method the folder of its weights ("": the project's own)."""

    engine: str
    keypoints: str
    tries: int
    seed: int
    out: Path
    weights: Mapping[str, str]


@dataclass(frozen=True)
class Cell:
    """One object, one scenario, one method."""

    domain: str
    object: str
    scenario: int
    method: str = OURS

    @property
    def folder(self) -> str:
        """Of its results, below the table's."""
        return f"{self.domain}/{self.object}_{self.scenario}_{self.method}"


@dataclass(frozen=True)
class Played:
    """What came of a cell: successes of episodes, failures by phase, and what went wrong where it was not played ("": nothing)."""

    cell: Cell
    successes: int = 0
    episodes: int = 0
    failures: Mapping[str, int] | None = None
    error: str = ""


def cells(domains: Iterable[str], objects: Sequence[str], methods: Iterable[str]) -> list[Cell]:
    """The table's cells, in the paper's order; objects: names, none for all. A baseline has the default object only.

    Raises ValueError for an object that no row of the domains has.
    """
    domains, methods = list(domains), list(methods)
    names = {name for domain in domains for name in rows_of(domain)}
    if unknown := sorted(set(objects) - names):
        raise ValueError(f"--objects: expected rows of {', '.join(domains)}, got {', '.join(unknown)}")
    return [
        Cell(domain, name, scenario, method)
        for method in methods
        for domain in domains
        for name in rows_of(domain)
        if (not objects or name in objects) and (method == OURS or name == DEFAULT)
        for scenario in range(1, COUNT + 1)
    ]


def play(cell: Cell, setting: Setting) -> Played:
    """Run `evaluate` on a cell, in a process and a ROS domain of its own; episodes that are there already are kept."""
    folder = setting.out / cell.folder
    folder.mkdir(parents=True, exist_ok=True)
    given = {
        "domain": cell.domain,
        "object": cell.object,
        "scenario": cell.scenario,
        "episodes": setting.tries,
        "seed": setting.seed,
        "engine": setting.engine,
        "keypoints": setting.keypoints,
        "controller": OSC if cell.method == OSC else "impedance",
        "weights": setting.weights[cell.method],
        "out": folder,
    }
    options = [text for name, value in given.items() if value != "" for text in (f"--{name}", str(value))]
    command = [sys.executable, "-m", "np_bringup.commands.evaluate", *options]
    with (folder / "evaluate.log").open("w") as log:
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=log, text=True, preexec_fn=end_with_parent)
    if done.returncode:
        words = (folder / "evaluate.log").read_text().strip().splitlines()
        return Played(cell, error=words[-1] if words else f"evaluate ended with status {done.returncode}")
    figures = json.loads(done.stdout.splitlines()[-1])
    episodes = figures["episodes"]
    return Played(cell, round(figures["success"] * episodes), episodes, figures["failures"])


def rows(played: Iterable[Played]) -> list[dict[str, object]]:
    """A row for each object and method: successes and episodes by scenario and in all, rate with its 95 % interval (Wilson), failures
    by phase, what went wrong, and the paper's successes of its 15 tries (None: it has none)."""
    by_row: dict[tuple[str, str, str], list[Played]] = {}
    for one in played:
        by_row.setdefault((one.cell.domain, one.cell.object, one.cell.method), []).append(one)
    return [
        {
            "domain": domain,
            "object": name,
            "method": method,
            "scenarios": {str(p.cell.scenario): [p.successes, p.episodes] for p in group},
            **_total(group),
            "errors": [f"scenario {p.cell.scenario}: {p.error}" for p in group if p.error],
            "paper_successes": papers(domain, name, method),
            "paper_tries": TRIES,
        }
        for (domain, name, method), group in by_row.items()
    ]


def papers(domain: str, name: str, method: str) -> int | None:
    """Successes of the paper, of TRIES."""
    if method == OURS:
        return rows_of(domain)[name].successes
    base = BASELINES[domain]
    return base.operational_space if method == OSC else base.fixed_limits


def totals(played: Sequence[Played]) -> dict[str, dict[str, object]]:
    """All of a method together, and the same of each domain: `ours`, `ours card` ..."""
    groups: dict[str, list[Played]] = {}
    for one in played:
        groups.setdefault(one.cell.method, []).append(one)
        groups.setdefault(f"{one.cell.method} {one.cell.domain}", []).append(one)
    return {name: _total(group) for name, group in sorted(groups.items())}


def _total(group: Sequence[Played]) -> dict[str, object]:
    successes, episodes = sum(p.successes for p in group), sum(p.episodes for p in group)
    failures = sum((Counter(p.failures or {}) for p in group), Counter())
    return {
        "successes": successes,
        "episodes": episodes,
        "success": round(successes / episodes, 4) if episodes else None,
        "ci95": [round(bound, 4) for bound in wilson_interval(successes, episodes)],
        "failures": dict(sorted(failures.items())),
    }
