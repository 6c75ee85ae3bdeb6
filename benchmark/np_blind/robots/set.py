"""Withheld robots in PhysX: what the diagnosis finds of each, what the rehearsal predicts, and how much lost success training on brings back.

    python -m np_blind.robots.set --seal --robots 12 --seed 31 --jobs 32       finds them, writes robots_12_31.json, puts its hash down
    python -m np_blind.robots.set --robots 12 --seed 31 --jobs 32 --minutes 1  the loop

A robot is a folder; the same command goes on where an earlier one was interrupted. Needs SAPIEN (`make physx`). The last line printed is one JSON object; robots.json lies in the folder.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from np_blind.robots.cases import SET, make_key, read_key
from np_blind.robots.effect_sizes import find_robots
from np_blind.robots.evaluation import ORACLES, EvaluationConfig, GpuPool, evaluate_robots
from np_blind.robots.figures import figures
from np_blind.robots.plot import plot_robots
from np_blind.sealed import KEYS, SealError, check_diagnosis_code, check_hash, commit_hash, digest
from np_common.cli import INTERRUPTED, Parser, interrupt_on_sigterm
from np_common.parallel import HELP, SINGLE_THREAD, workers
from np_description.weights.provenance import origin
from np_evaluation.finetune.learning import Learning, list_gpus
from np_physx_bridge.library import missing

LOCKED_FROM = 30  # seed from which on a set is sealed


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(
        prog="python -m np_blind.robots.set", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robots", type=int, default=12, help="of the set (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the set (default: %(default)s)")
    parser.add_argument("--seal", action="store_true", help="find the robots, write the key and put down its hash")
    parser.add_argument("--pairs", type=int, default=32, help="--seal: episodes by which a loss is measured")
    parser.add_argument("--episodes", type=int, default=200, help="of every figure (default: %(default)s)")
    parser.add_argument("--share-episodes", type=int, default=50, help="of every subset of the effects found")
    parser.add_argument("--minutes", type=float, default=5.0, help="of training; 0: corrections only")
    parser.add_argument("--each-gpu", type=int, default=1, help="trainings at a time on a GPU")
    parser.add_argument(
        "--oracle", choices=ORACLES, default="all", help="robots with which the same is done with the true effects"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes that play episodes")
    parser.add_argument("--cluster", default="", help=HELP)
    parser.add_argument("--key", type=Path, help="default: OUT/../robots_ROBOTS_SEED.json")
    parser.add_argument("--out", type=Path, help="default: runs/blind/robots_ROBOTS_SEED")
    parser.add_argument("--train", nargs=argparse.REMAINDER, default=[], help="further options of np_training.train")
    options = parser.parse_args(arguments)
    options.out = (options.out or Path("runs/blind") / f"{SET}_{options.robots}_{options.seed}").resolve()
    options.key = options.key or options.out.parent / f"{SET}_{options.robots}_{options.seed}.json"
    if problem := missing():
        parser.error(problem)
    return options


def seal(options: argparse.Namespace) -> dict:
    """Find the robots and write the hash of their key down; that of a development set is only printed."""
    played = options.out.with_name(f"{options.out.name}_sizes")
    with workers(options.jobs, options.cluster) as pool:
        robots, not_found = find_robots(options.robots, options.seed, pool, options.pairs, played)
    if not robots:
        raise ValueError("; ".join(not_found))
    key = make_key(robots, options.seed)
    options.key.parent.mkdir(parents=True, exist_ok=True)
    options.key.write_text(key, encoding="utf-8")
    found = commit_hash(key) if options.seed >= LOCKED_FROM else digest(key)
    return {"key": str(options.key), "sha256": found, "keys": str(KEYS), "robots": len(robots), "not_found": not_found}


def evaluate(options: argparse.Namespace) -> dict:
    """The loop over the robots of the key."""
    key = options.key.read_text(encoding="utf-8")
    is_locked = options.seed >= LOCKED_FROM
    sealed = check_hash(key) if is_locked else digest(key)
    options.out.mkdir(parents=True, exist_ok=True)
    code = check_diagnosis_code(options.out, is_locked)
    there = list_gpus()
    gpu = there[0] if there else None
    training = Learning(options.minutes, gpu, options=tuple(options.train)) if options.minutes > 0 else None
    config = EvaluationConfig(
        options.out, options.seed, options.episodes, options.share_episodes, training, options.oracle
    )
    begun = time.monotonic()
    with workers(options.jobs, options.cluster) as pool:
        rows = evaluate_robots(read_key(options.key), config, pool, GpuPool(there, options.each_gpu))
    found = {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "command": _command(options),
        "set": SET,
        "seed": options.seed,
        "drawn": options.robots,
        "key_sha256": sealed,
        "diagnosis_sha256": code,
        **origin(),
        "episodes": options.episodes,
        "share_episodes": options.share_episodes,
        "minutes": options.minutes,
        "gpus": len(there),
        "figures": figures(rows),
        "rows": rows,
        "wall_s": round(time.monotonic() - begun, 1),
    }
    results = options.out / "robots.json"
    results.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    with suppress(ImportError):  # the figures are worth more than their picture
        plot_robots(rows, results.with_suffix(".svg"))
    return {"robots": len(rows), "figures": found["figures"], "wall_s": found["wall_s"], "results": str(results)}


def _command(options: argparse.Namespace) -> str:
    """The command that repeats the evaluation."""
    text = (
        f"python -m np_blind.robots.set --robots {options.robots} --seed {options.seed} --episodes {options.episodes}"
        f" --share-episodes {options.share_episodes} --minutes {options.minutes:g} --each-gpu {options.each_gpu}"
        f" --oracle {options.oracle} --jobs {options.jobs}"
    )
    return text + (f" --train {' '.join(options.train)}" if options.train else "")


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Status 2: a key that is not the one whose hash was put down."""
    options = parse(arguments)
    interrupt_on_sigterm()
    os.environ.update(SINGLE_THREAD)  # of the processes that are started: an episode has a core
    try:
        summary = seal(options) if options.seal else evaluate(options)
    except KeyboardInterrupt:
        print("interrupted; what is finished is kept, the same command goes on with the rest", file=sys.stderr)
        return INTERRUPTED
    except (SealError, OSError, ValueError) as error:
        print(f"robots.set: {error}", file=sys.stderr)
        return 2 if isinstance(error, SealError) else 1
    print(json.dumps(summary))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
