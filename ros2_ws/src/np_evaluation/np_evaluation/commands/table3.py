"""`table3`: the paper's 21 objects in three scenarios each, through the whole graph, printed beside the paper's successes.

A cell is an object in a scenario: an `evaluate` of its own, JOBS of them at a time. The same command later goes on where it ended.
The last line printed is one JSON object; table.json and the episodes lie in the folder.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Mapping
from concurrent.futures import as_completed
from pathlib import Path

from np_common.cli import Parser, Progress
from np_common.parallel import workers
from np_description.domains import DOMAINS
from np_description.objects.scenarios import COUNT
from np_description.weights.provenance import origin
from np_evaluation.commands.episode_options import add_options, check_options, run_command
from np_evaluation.paper_table import (
    CellResult,
    TableCell,
    TableSettings,
    episodes,
    play_cell,
    table_cells,
    table_rows,
    table_totals,
)
from np_evaluation.scoring import code_sha256


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="table3", description=__doc__.split("\n")[0])
    parser.add_argument("--domains", nargs="+", choices=list(DOMAINS), default=list(DOMAINS))
    parser.add_argument("--objects", nargs="+", default=[], help="rows of the table; default: all")
    parser.add_argument("--scenarios", nargs="+", type=int, choices=range(1, COUNT + 1), default=range(1, COUNT + 1))
    parser.add_argument("--tries", type=int, default=5, help="episodes a scenario; the paper has 5")
    add_options(parser, jobs=os.cpu_count(), out="runs/table3")
    options = parser.parse_args(arguments)
    check_options(parser, options, ("tries",))
    return options


def table3(options: argparse.Namespace) -> dict[str, object]:
    """Play every cell; rows, totals and the request. Raises ValueError for an object that no row has."""
    asked = table_cells(options.domains, options.objects, options.scenarios)
    again = f"_contacts{options.contacts}" if options.contacts > 1 else ""
    place = options.out.resolve() / f"{options.engine}_{options.keypoints}_{options.seed}{again}"
    setting = TableSettings(
        options.engine,
        options.keypoints,
        options.tries,
        options.seed,
        place,
        str(Path(options.weights).resolve()) if options.weights else "",
        options.contacts,
    )
    place.mkdir(parents=True, exist_ok=True)
    what_runs = {"code_sha256": code_sha256(), **origin(options.weights)}  # now: files may be edited meanwhile
    began = time.monotonic()
    played = _play_cells(asked, setting, options)
    in_order = [played[cell] for cell in asked]
    table = {
        "engine": options.engine,
        "keypoints": options.keypoints,
        "contacts": options.contacts,
        "tries": options.tries,
        "seed": options.seed,
        **what_runs,
        "totals": table_totals(in_order),
        "rows": table_rows(in_order),
        "per_episode": episodes(in_order),
        "wall_s": round(time.monotonic() - began, 1),
    }
    (place / "table.json").write_text(json.dumps(table, indent=1) + "\n")
    return {**table, "results": str(place / "table.json")}


def _play_cells(
    asked: list[TableCell], setting: TableSettings, options: argparse.Namespace
) -> dict[TableCell, CellResult]:
    played: dict[TableCell, CellResult] = {}
    progress = Progress(len(asked), "table3")
    with workers(options.jobs, options.cluster) as pool:
        # Scenario by scenario: whatever ends it, every row has about as much.
        in_turn = sorted(asked, key=lambda cell: cell.scenario)
        playing = {pool.submit(play_cell, cell, setting): cell for cell in in_turn}
        progress.show(0)
        for future in as_completed(playing):
            cell, error = playing[future], future.exception()
            played[cell] = CellResult(cell, error=f"{type(error).__name__}: {error}") if error else future.result()
            progress.show(len(played), _so_far(played.values()))
    return played


def _so_far(played) -> str:
    tried = sum(len(p.results) for p in played)
    return f"success {sum(p.successes for p in played)}/{tried}" if tried else ""


def format_table(table: Mapping) -> str:
    """The table as lines of text."""
    numbers = sorted({number for row in table["rows"] for number in row["scenarios"]})
    again = any("first_contact" in row for row in table["rows"])
    head = "".join(f"{f'scenario {n}':>11}" for n in numbers)
    lines = [
        f"{'':24}{head} {'all':>8} {'rate, 95 %':>20}" + (f" {'first contact':>20}" if again else "") + f" {'paper':>7}"
    ]
    for row in table["rows"]:
        name = f"{row['domain']} {row['object']}"
        each = "".join(f"{'{}/{}'.format(*row['scenarios'].get(n, (0, 0))):>11}" for n in numbers)
        first = f" {_rate(row.get('first_contact', row)):>20}" if again else ""
        paper = f"{row['paper_successes']}/{row['paper_tries']}"
        lines.append(f"{name:24}{each} {row['successes']:>4}/{row['episodes']:<3} {_rate(row):>20}{first} {paper:>7}")
        lines += [f"  {error}" for error in row["errors"]]
    return "\n".join(lines)


def _rate(figures: Mapping) -> str:
    if figures["success"] is None:
        return "not played"
    return f"{figures['success']:.2f} ({figures['ci95'][0]:.2f} to {figures['ci95'][1]:.2f})"


def _print_table(table: Mapping) -> tuple[Mapping, int]:
    print(format_table(table))
    short = {key: value for key, value in table.items() if key not in ("rows", "per_episode", "weights_sha256")}
    return short, int(any(row["errors"] for row in table["rows"]))


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object. 1 where a cell was not played."""
    options = parse(arguments)
    return run_command("table3", lambda: table3(options), _print_table)


if __name__ == "__main__":
    raise SystemExit(main())
