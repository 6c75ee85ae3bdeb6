"""Episodes without a graph: `np_bringup.one_process`, true corners.

    python tools/one_process.py --domains bump wall --engine physx --tries 5 --out FOLDER          # the paper's table
    python tools/one_process.py --domains bump --object cube.yaml --tries 24 [--alone]              # drawn tasks, one object

--alone: the contact is chosen as if the object had the size that the weights know. --effects: what arm, scene and view have besides.
The last line printed is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import torch

from np_bringup.evaluation import code_sha256, summary
from np_bringup.one_process import OneProcess
from np_bringup.paper_table import OURS, Played, cells, episodes, rows, totals
from np_description.domains import DOMAINS
from np_description.objects.choice import DEFAULT, domain_with, portable
from np_effects.patch import Patch, load_patch
from np_record.command import Progress, origin


def main() -> None:
    """Play what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--domains", nargs="+", choices=list(DOMAINS), default=["bump", "wall"])
    parser.add_argument("--rows", nargs="+", default=[], help="rows of the table; default: all")
    parser.add_argument("--object", help="drawn tasks with this one, in place of the table")
    parser.add_argument("--engine", choices=("mujoco", "physx"), default="mujoco")
    parser.add_argument("--tries", type=int, default=5, help="episodes, of a cell in the table")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--contacts", type=int, default=1)
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--effects", type=Path, help="patch.yaml; with --object")
    parser.add_argument("--weights", default="", help="folder of other weights")
    parser.add_argument("--out", type=Path, help="file for the table")
    options = parser.parse_args()
    torch.set_num_threads(1)
    what = dict(seed=options.seed, contacts=options.contacts, alone=options.alone, weights=options.weights)
    patch = load_patch(options.effects) if options.effects else Patch()
    if options.object:
        (name,) = options.domains
        text = options.object if options.object == DEFAULT else portable(name, options.object)
        played = OneProcess(domain_with(name, text), options.engine, patch=patch, **what)
        results = [played.play(number) for number in range(options.tries)]
        print(json.dumps({"domain": name, "object": text, "engine": options.engine, **what, **summary(results)}))
        return
    asked, began, finished = cells(options.domains, options.rows, [OURS]), time.monotonic(), []
    where = {"code_sha256": code_sha256(), **origin()}
    progress = Progress(len(asked), "table")
    for cell in asked:
        played = OneProcess(domain_with(cell.domain, cell.object), options.engine, patch=patch, **what)
        finished.append(Played(cell, tuple(played.play(n, cell.scenario) for n in range(options.tries))))
        progress.show(len(finished), f"success {sum(p.successes for p in finished)}")
        table = {
            "engine": options.engine,
            "keypoints": "truth",
            "graph": False,
            "contacts": options.contacts,
            "tries": options.tries,
            "seed": options.seed,
            **where,
            "totals": totals(finished),
            "rows": rows(finished),
            "per_episode": episodes(finished),
            "wall_s": round(time.monotonic() - began, 1),
        }
        if options.out:
            options.out.write_text(json.dumps(table, indent=1) + "\n")
    print(json.dumps(table["totals"]))


if __name__ == "__main__":
    main()
