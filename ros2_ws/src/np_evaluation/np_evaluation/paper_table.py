"""The paper's Table III, played again: 21 objects in three scenarios each.

Kim et al., IROS 2023, Table III: five tries in each scenario with a real Panda. Here a try is an episode through the whole graph.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from np_common.parent_process import end_with_parent
from np_description.objects.scenarios import COUNT
from np_description.objects.table import TRIES, rows_of
from np_evaluation.results import read_results
from np_evaluation.scoring import Result, reasons, summary

OURS = "ours"
"""The method's name in rows and totals: results of before name the paper's baselines beside it."""


@dataclass(frozen=True)
class TableSettings:
    """The settings that all cells of a table share."""

    engine: str
    """mujoco or physx."""
    keypoints: str
    """camera or truth."""
    tries: int
    """Episodes a scenario."""
    seed: int
    """Of tasks and sensors."""
    out: Path
    """Folder of the results."""
    weights: str = ""
    """Folder; empty: the project's own."""
    contacts: int = 1
    """How often a contact may be chosen in an episode."""


@dataclass(frozen=True)
class TableCell:
    """One object in one scenario."""

    domain: str
    """Task family."""
    object: str
    """Row of its table of objects."""
    scenario: int
    """Number, from 1."""

    @property
    def folder(self) -> str:
        """The folder of its results, below the table's."""
        return f"{self.domain}/{self.object}_{self.scenario}_{OURS}"


@dataclass(frozen=True)
class CellResult:
    """The result of a cell."""

    cell: TableCell
    """The cell."""
    results: tuple[Result, ...] = ()
    """Its episodes in order."""
    error: str = ""
    """Why it was not played; empty: it was."""

    @property
    def successes(self) -> int:
        """Number of successful episodes."""
        return sum(result.success for result in self.results)


def table_cells(
    domains: Iterable[str],
    objects: Sequence[str],
    scenarios: Collection[int] = range(1, COUNT + 1),
) -> list[TableCell]:
    """The table's cells, in the paper's order; objects: names, none for all.

    Raises ValueError for an object that no row of the domains has.
    """
    domains = list(domains)
    names = {name for domain in domains for name in rows_of(domain)}
    if unknown := sorted(set(objects) - names):
        raise ValueError(f"--objects: expected rows of {', '.join(domains)}, got {', '.join(unknown)}")
    return [
        TableCell(domain, name, scenario)
        for domain in domains
        for name in rows_of(domain)
        if not objects or name in objects
        for scenario in sorted(set(scenarios))
    ]


def play_cell(cell: TableCell, setting: TableSettings) -> CellResult:
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
        "contacts": setting.contacts,
        "weights": setting.weights,
        "out": folder,
    }
    options = [text for name, value in given.items() if value != "" for text in (f"--{name}", str(value))]
    command = [sys.executable, "-m", "np_evaluation.commands.evaluate", *options]
    with (folder / "evaluate.log").open("w") as log:
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=log, text=True, preexec_fn=end_with_parent)
    if done.returncode:
        words = (folder / "evaluate.log").read_text().strip().splitlines()
        return CellResult(cell, error=words[-1] if words else f"evaluate ended with status {done.returncode}")
    file = Path(json.loads(done.stdout.splitlines()[-1])["results"])
    return CellResult(cell, tuple(read_results(file)[: setting.tries]))


def table_rows(played: Iterable[CellResult]) -> list[dict[str, object]]:
    """A row for each object.

    It has successes and episodes by scenario and in all, and the rate with its 95 % interval (Wilson). The same with the first
    contact follows where some episodes had more. Then come failures by phase and by the graph's reason, what went wrong, and
    the paper's successes of its 15 tries.
    """
    by_row: dict[tuple[str, str], list[CellResult]] = {}
    for one in played:
        by_row.setdefault((one.cell.domain, one.cell.object), []).append(one)
    return [
        {
            "domain": domain,
            "object": name,
            "method": OURS,
            "scenarios": {str(p.cell.scenario): [p.successes, len(p.results)] for p in group},
            **_total(group),
            "errors": [f"scenario {p.cell.scenario}: {p.error}" for p in group if p.error],
            "paper_successes": rows_of(domain)[name].successes,
            "paper_tries": TRIES,
        }
        for (domain, name), group in by_row.items()
    ]


def table_totals(played: Sequence[CellResult]) -> dict[str, dict[str, object]]:
    """All cells together, and those of each domain: `ours`, `ours card` ..."""
    groups: dict[str, list[CellResult]] = {}
    for one in played:
        groups.setdefault(OURS, []).append(one)
        groups.setdefault(f"{OURS} {one.cell.domain}", []).append(one)
    return {name: _total(group) for name, group in sorted(groups.items())}


def episodes(played: Iterable[CellResult]) -> list[dict[str, object]]:
    """Every episode, with its cell: what a table is made of, without how deep and how near to limits things were."""
    left_out = ("engine", "depths", "limit_shares")
    return [
        {
            **asdict(one.cell),
            "method": OURS,
            **{name: value for name, value in asdict(result).items() if name not in left_out},
        }
        for one in played
        for result in one.results
    ]


def _total(group: Sequence[CellResult]) -> dict[str, object]:
    results = [result for one in group for result in one.results]
    shown = (
        "success",
        "ci95",
        "first_contact",
        "failures",
        "declared_wrongly",
        "missed",
        "force_n",
        "raw_peak_n",
        "peak_by",
        "reflex_stops",
    )
    figures = {name: value for name, value in summary(results).items() if name in shown}
    return {
        "successes": sum(r.success for r in results),
        "episodes": len(results),
        **figures,
        "reasons": reasons(results),
    }
