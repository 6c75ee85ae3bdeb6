"""`table3`: the paper's 21 objects in three scenarios each, through the whole graph, printed beside the paper's successes.

A cell is an object in a scenario: an `evaluate` of its own, JOBS of them at a time. The same command later goes on where it ended. The
last line printed is one JSON object; table.json, table.svg and the episodes lie in the folder.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from concurrent.futures import as_completed
from pathlib import Path

from np_bringup.backends import ENGINES
from np_bringup.paper_table import FIXED, OSC, OURS, TITLES, Played, Setting, cells, play, rows, totals
from np_bringup.task_graph import KEYPOINT_SOURCES
from np_description.domains import DOMAINS
from np_physx_bridge.library import missing
from np_record.command import INTERRUPTED, Progress, interrupt_on_sigterm
from np_record.workers import HELP, workers
from np_record.workers import missing as missing_cluster


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = argparse.ArgumentParser(prog="table3", description=__doc__.split("\n")[0])
    parser.add_argument("--domains", nargs="+", choices=list(DOMAINS), default=list(DOMAINS))
    parser.add_argument("--objects", nargs="+", default=[], help="rows of the table; default: all")
    parser.add_argument("--tries", type=int, default=5, help="episodes a scenario; the paper has 5")
    parser.add_argument("--seed", type=int, default=0, help="of the starts' scatter and of what sensors add")
    parser.add_argument("--engine", choices=list(ENGINES), default="mujoco", help="whose physics the robot has")
    parser.add_argument("--keypoints", choices=KEYPOINT_SOURCES, default="camera")
    parser.add_argument("--weights", default="", help="folder with weights; default: the project's own")
    parser.add_argument("--osc", default="", metavar="FOLDER", help=f"weights of the baseline {TITLES[OSC]}")
    parser.add_argument("--fixed-limits", default="", metavar="FOLDER", help=f"weights of the baseline {TITLES[FIXED]}")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="graphs at a time (default: one a core)")
    parser.add_argument("--cluster", default="", help=HELP)
    parser.add_argument(
        "--out", type=Path, default=Path("runs/table3"), help="folder of results, goes on where it ended"
    )
    options = parser.parse_args(arguments)
    if options.tries < 1 or options.jobs < 1:
        parser.error("--tries, --jobs: expected at least 1")
    if options.engine == "physx" and missing():
        parser.error(f"--engine physx: {missing()}")
    if problem := missing_cluster(options.cluster):
        parser.error(f"--cluster {problem}")
    return options


def table3(options: argparse.Namespace) -> dict[str, object]:
    """Play every cell; rows, totals and what was asked for. Raises ValueError for an object that no row has."""
    baselines = {name: folder for name, folder in ((OSC, options.osc), (FIXED, options.fixed_limits)) if folder}
    weights = {OURS: options.weights, **baselines}
    asked = cells(options.domains, options.objects, weights)
    place = options.out.resolve() / f"{options.engine}_{options.keypoints}_{options.seed}"
    setting = Setting(
        options.engine,
        options.keypoints,
        options.tries,
        options.seed,
        place,
        {name: str(Path(folder).resolve()) if folder else "" for name, folder in weights.items()},
    )
    place.mkdir(parents=True, exist_ok=True)
    began, progress, played = time.monotonic(), Progress(len(asked), "table3"), {}
    with workers(options.jobs, options.cluster) as pool:
        playing = {pool.submit(play, cell, setting): cell for cell in asked}
        progress.show(0)
        for future in as_completed(playing):
            cell, error = playing[future], future.exception()
            played[cell] = Played(cell, error=f"{type(error).__name__}: {error}") if error else future.result()
            progress.show(len(played), _so_far(played.values()))
    in_order = [played[cell] for cell in asked]
    table = {
        "engine": options.engine,
        "keypoints": options.keypoints,
        "tries": options.tries,
        "seed": options.seed,
        "totals": totals(in_order),
        "rows": rows(in_order),
        "wall_s": round(time.monotonic() - began, 1),
    }
    from np_bringup.paper_table_plot import table_plot  # slow to import

    (place / "table.json").write_text(json.dumps(table, indent=1) + "\n")
    (place / "table.svg").write_text(table_plot(table["rows"]))
    return {**table, "results": str(place / "table.json"), "plot": str(place / "table.svg")}


def _so_far(played) -> str:
    episodes = sum(p.episodes for p in played)
    return f"success {sum(p.successes for p in played)}/{episodes}" if episodes else ""


def printed(table: dict) -> str:
    """The table as lines of text."""
    lines = [f"{'':24} {'scenario 1':>10} {'2':>7} {'3':>7} {'all':>8} {'rate, 95 %':>20} {'paper':>7}"]
    for row in table["rows"]:
        name = f"{row['domain']} {row['object']}" + (f" ({row['method']})" if row["method"] != OURS else "")
        each = [f"{s}/{n}" for s, n in row["scenarios"].values()]
        rate = (
            f"{row['success']:.2f} ({row['ci95'][0]:.2f} to {row['ci95'][1]:.2f})" if row["episodes"] else "not played"
        )
        paper = "" if row["paper_successes"] is None else f"{row['paper_successes']}/{row['paper_tries']}"
        lines.append(
            f"{name:24} {each[0]:>10} {each[1]:>7} {each[2]:>7} {row['successes']:>4}/{row['episodes']:<3} {rate:>20} {paper:>7}"
        )
        lines += [f"  {error}" for error in row["errors"]]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object. 1 where a cell was not played."""
    options = parse(arguments)
    interrupt_on_sigterm()
    try:
        table = table3(options)
    except KeyboardInterrupt:
        print("interrupted; finished episodes are kept, the same command goes on with the next", file=sys.stderr)
        return INTERRUPTED
    except (ValueError, OSError) as error:
        print(f"table3: {error}", file=sys.stderr)
        return 1
    print(printed(table))
    print(json.dumps({key: value for key, value in table.items() if key != "rows"}))
    return int(any(row["errors"] for row in table["rows"]))


if __name__ == "__main__":
    raise SystemExit(main())
