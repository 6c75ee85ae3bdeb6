"""Does simulation predict reality? Policies of other days on withheld robots: nominal simulator, patched simulator, and PhysX.

    python -m np_blind.robots.matrix --prepare --policies runs/policies
    python -m np_blind.robots.matrix --key runs/blind/robots_12_31.json --set runs/blind/robots_12_31 --policies runs/policies --jobs 32

--prepare takes the weights of `data/policies.yaml` out of the history; where there is no history, its folder is enough. --set: the folder of
`robots.set`, whose diagnoses are the patches, and whose episodes are those of the released policies, one more. A cell is a file, and is not played again. The last line printed is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path

import numpy as np
import yaml
from sim2real.effects.patch import load_patch

from np_blind.robots.cases import Robot, read_key
from np_blind.robots.evaluation import TASKS, reality_of
from np_blind.robots.plot import plot_matrix
from np_blind.robots.prediction import exact_prediction_figures, prediction_figures
from np_common.cli import INTERRUPTED, Parser, interrupt_on_sigterm
from np_common.parallel import HELP, SINGLE_THREAD, workers
from np_description.weights.header import read_metadata
from np_description.weights.released import WeightsError
from np_evaluation.finetune.rollouts import CachedScores, RolloutCell, run_all_rollouts, succeeds, text_of
from np_policy.contract import KINDS, PRE_CONTACT

POLICIES = Path(str(files("np_blind") / "data" / "policies.yaml"))
RELEASED = "released"  # the policy of the project's own weights, whose episodes `robots.set` has played already
SIDES = ("nominal", "patched", "patched_score", "engine")
"""What a cell's policy has: success by the two simulators, the patched one's mean score (`np_evaluation.finetune.rollouts`), and success in PhysX."""


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(
        prog="python -m np_blind.robots.matrix",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--policies", type=Path, default=Path("runs/policies"), help="folder of weights, DOMAIN/NAME")
    parser.add_argument("--prepare", action="store_true", help="fill that folder from the history, and do no more")
    parser.add_argument("--key", type=Path, help="of the robots")
    parser.add_argument("--set", type=Path, help="folder of robots.set")
    parser.add_argument("--episodes", type=int, default=50, help="of every cell (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--cluster", default="", help=HELP)
    parser.add_argument("--out", type=Path, default=Path("runs/blind/matrix"))
    options = parser.parse_args(arguments)
    if not options.prepare and not (options.key and options.set):
        parser.error("expected --key and --set, or --prepare")
    return options


def prepare(folder: Path) -> list[str]:
    """Weights of every policy of the list, with a contract where theirs had none yet; their folders. Raises OSError without the history."""
    from np_training.contracts import add_contract  # slow

    made = []
    for domain, policies in yaml.safe_load(POLICIES.read_text(encoding="utf-8")).items():
        for policy in policies:
            place = folder / domain / policy["name"]
            place.mkdir(parents=True, exist_ok=True)
            for kind in KINDS:
                name = f"{kind}_{domain}.safetensors"
                revision = policy.get("chooses", policy["revision"]) if kind == PRE_CONTACT else policy["revision"]
                command = ["git", "-C", str(POLICIES.parent), "show", f"{revision}:weights/{name}"]
                done = subprocess.run(command, capture_output=True)
                if done.returncode:
                    raise OSError(f"{revision}:weights/{name}: {done.stderr.decode().strip()}")
                (place / name).write_bytes(done.stdout)
                if "contract" not in read_metadata(place / name):
                    add_contract(place / name)
            made.append(str(place))
    return made


def cells_of(robots: Sequence[Robot], diagnoses: Path, policies: Path) -> dict[str, RolloutCell]:
    """Cells by name: `nominal_DOMAIN_POLICY`, and of each robot `patched_NUMBER_POLICY` and `engine_NUMBER_POLICY`."""
    cells = {}
    for robot in robots:
        patch = text_of(load_patch(diagnoses / robot.folder / "patch.yaml"))
        for place in sorted((policies / robot.domain).iterdir()):
            weights = str(place.resolve())
            cells[f"nominal_{robot.domain}_{place.name}"] = RolloutCell(robot.domain, weights=weights, seed=TASKS)
            cells[f"patched_{robot.number}_{place.name}"] = RolloutCell(
                robot.domain, effects=patch, weights=weights, seed=TASKS
            )
            cells[f"engine_{robot.number}_{place.name}"] = RolloutCell(
                robot.domain, "physx", text_of(robot.patch), weights, seed=TASKS
            )
    return cells


def scores_of_released(robots: Sequence[Robot], diagnoses: Path, episodes: int) -> dict[str, list[float]]:
    """Scores of the project's own weights by the names of their cells, of those of which `robots.set` has played so many episodes."""
    found = {}
    for robot in robots:
        patch, own = text_of(load_patch(diagnoses / robot.folder / "patch.yaml")), diagnoses / robot.folder / "episodes"
        believed = RolloutCell(robot.domain, seed=TASKS)
        for name, folder, file, cell in (
            (f"nominal_{robot.domain}", diagnoses / "nominal", f"{robot.domain}_mujoco", believed),
            (f"patched_{robot.number}", own, "patched", replace(believed, effects=patch)),
            (f"engine_{robot.number}", own, "reality", reality_of(robot)),
        ):
            kept = CachedScores(folder, {file: cell})
            if not kept.missing(file, episodes):
                found[f"{name}_{RELEASED}"] = kept.of(file, episodes)
    return found


def figures(table: Sequence[Mapping], episodes: int) -> dict:
    """r over all cells, MMRV of the policies of a robot in the mean over robots, and the mean error, of both simulators, and of the scores in the
    patched one; of r and MMRV 95 % intervals too, by the bootstrap over robots, where there are several. `exact`: of a simulator with
    reality's own rates of success, by so few episodes.

    table: rows with robot, policy, and success by side, in so many episodes.
    """
    robots = sorted({row["robot"] for row in table})

    def pairs(side: str) -> list[np.ndarray]:
        return [np.array([(r[side], r["engine"]) for r in table if r["robot"] == robot]) for robot in robots]

    found = {side: prediction_figures(pairs(side)) for side in SIDES[:-1] if all(side in row for row in table)}
    found["exact"] = exact_prediction_figures(pairs("patched"), episodes)
    if "patched_score" in found:  # a score is no share of episodes: it ranks
        found["patched_score"] = {k: None if "error" in k else value for k, value in found["patched_score"].items()}
    return {**found, "cells": len(table), "robots": len(robots)}


def play(options: argparse.Namespace) -> dict:
    """Every cell, and the figures of the robots that are finished. Raises OSError where none is."""
    robots = [r for r in read_key(options.key) if (options.set / r.folder / "patch.yaml").exists()]
    cells = cells_of(robots, options.set, options.policies)
    with workers(options.jobs, options.cluster) as pool:
        run_all_rollouts(cells, options.episodes, options.out, pool, f"matrix, {options.episodes} episodes")
    kept, episodes = CachedScores(options.out, cells), options.episodes
    scores = {name: kept.of(name, episodes) for name in cells}
    table = [_row(r, p.name, scores) for r in robots for p in sorted((options.policies / r.domain).iterdir())]
    released = scores_of_released(robots, options.set, episodes)
    table += [row for robot in robots if (row := _row(robot, RELEASED, released))]
    if not table:
        raise OSError(f"{options.set}: expected robots with a patch.yaml, got {len(robots)}")
    command = f"python -m np_blind.robots.matrix --key KEY --set SET --policies POLICIES --episodes {options.episodes}"
    date = datetime.now(UTC).strftime("%Y-%m-%d")
    found = {
        "date": date,
        "command": command,
        "episodes": episodes,
        "figures": figures(table, episodes),
        "table": table,
    }
    results = options.out / "matrix" / "matrix.json"
    results.parent.mkdir(parents=True, exist_ok=True)
    results.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    with suppress(ImportError):
        plot_matrix(table, results.with_suffix(".svg"))
    return {**found["figures"], "results": str(results)}


def _row(robot: Robot, policy: str, scores: Mapping[str, Sequence[float]]) -> dict | None:
    """What a policy has on a robot by side; None where one is not known."""
    names = {
        "nominal": f"nominal_{robot.domain}_{policy}",
        "patched": f"patched_{robot.number}_{policy}",
        "engine": f"engine_{robot.number}_{policy}",
    }
    if any(name not in scores for name in names.values()):
        return None
    row = {"robot": robot.number, "domain": robot.domain, "policy": policy}
    row |= {side: float(np.mean(succeeds(scores[name]))) for side, name in names.items()}
    return row | {"patched_score": round(float(np.mean(scores[names["patched"]])), 4)}


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    options = parse(arguments)
    interrupt_on_sigterm()
    os.environ.update(SINGLE_THREAD)
    try:
        summary = {"policies": prepare(options.policies)} if options.prepare else play(options)
    except KeyboardInterrupt:
        print("interrupted; cells that are finished are kept", file=sys.stderr)
        return INTERRUPTED
    except (OSError, ValueError, WeightsError) as error:
        print(f"robots.matrix: {error}", file=sys.stderr)
        return 1
    print(json.dumps(summary))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
