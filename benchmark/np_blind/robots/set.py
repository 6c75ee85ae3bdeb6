"""Withheld robots in PhysX: what the doctor finds of each, what the rehearsal predicts, and how much lost success training on brings back.

    python -m np_blind.robots.set --seal --robots 12 --seed 31 --jobs 32       finds them, writes robots_12_31.json, puts its hash down
    python -m np_blind.robots.set --robots 12 --seed 31 --jobs 32 --minutes 1  the loop

A robot is a folder; a call does what is not there, and --within ends it in time. --from, --to: some of them. Needs SAPIEN (`make physx`). The
last line printed is one JSON object; robots.json lies in the folder.
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

from np_blind.robots.answering import ORACLES, Judging, Turns, answered, is_diagnosed, settle_all
from np_blind.robots.before import play_before
from np_blind.robots.cases import SET, Robot, make_key, read_key
from np_blind.robots.figures import figures
from np_blind.robots.plot import plot_robots
from np_blind.robots.queue import AT_ONCE, ENGINE, Queue, TimeOver
from np_blind.robots.sizes import find_robots
from np_blind.sealed import KEYS, SealError, answered_by, check, check_doctor, digest, put_down
from np_common.cli import INTERRUPTED, Parser, interrupt_on_sigterm
from np_common.parallel import HELP, SINGLE_THREAD, workers
from np_description.weights.provenance import origin
from np_evaluation.finetune.learning import Learning, gpus
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
    parser.add_argument("--as-found", action="store_true", help="--seal: also where the time is over for some robots")
    parser.add_argument("--from", dest="first", type=int, default=0, help="the first robot of this call")
    parser.add_argument("--to", dest="last", type=int, help="the one after the last")
    parser.add_argument("--episodes", type=int, default=200, help="of every figure (default: %(default)s)")
    parser.add_argument("--share-episodes", type=int, default=50, help="of every subset of the effects found")
    parser.add_argument("--minutes", type=float, default=5.0, help="of training")
    parser.add_argument("--each-gpu", type=int, default=1, help="trainings at a time on a GPU")
    parser.add_argument(
        "--oracle", choices=ORACLES, default="all", help="robots with which the same is done with the true effects"
    )
    parser.add_argument(
        "--oracle-first", action="store_true", help="train with the true effects while doctors are still asked"
    )
    parser.add_argument(
        "--no-training",
        dest="train_on",
        action="store_false",
        help="only what takes no GPU: diagnoses and old policies",
    )
    parser.add_argument(
        "--diagnosed", action="store_true", help="only robots whose diagnosis is there: no doctor is asked"
    )
    parser.add_argument(
        "--leave",
        nargs="*",
        default=[],
        metavar="EFFECT",
        help="not corrected, but trained for: what corrections did not have yet when a key was sealed",
    )
    parser.add_argument(
        "--before", action="store_true", help="only what asks no doctor: what robots lose, and by which effect"
    )
    parser.add_argument("--answered", action="store_true", help="figures of the rows that are there, and do no more")
    parser.add_argument(
        "--within",
        type=float,
        default=float("inf"),
        help="s after which nothing is begun and no training goes on: the same command does the rest",
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
    """Find the robots and put down the hash of their key, of a development set nowhere."""
    played = options.out.with_name(f"{options.out.name}_sizes")
    until = time.time() + options.within
    with workers(options.jobs, options.cluster) as pool:
        queue = Queue(pool, AT_ONCE if options.cluster else options.jobs, until)
        robots, not_found, late = find_robots(options.robots, options.seed, queue.ranked(ENGINE), options.pairs, played)
    if late:
        not_found.append(f"the time was over for robots {late}, the same command goes on with them")
    if not robots or (late and not options.as_found):
        raise ValueError("; ".join(not_found))
    key = make_key(robots, options.seed)
    options.key.parent.mkdir(parents=True, exist_ok=True)
    options.key.write_text(key, encoding="utf-8")
    found = put_down(key) if options.seed >= LOCKED_FROM else digest(key)
    return {"key": str(options.key), "sha256": found, "keys": str(KEYS), "robots": len(robots), "not_found": not_found}


def judge(options: argparse.Namespace) -> dict:
    """The loop over the robots that the command line names."""
    key = options.key.read_text(encoding="utf-8")
    is_locked = options.seed >= LOCKED_FROM
    sealed = check(key) if is_locked else digest(key)
    options.out.mkdir(parents=True, exist_ok=True)
    robots = read_key(options.key)[options.first : options.last]
    if options.before:
        return _before(robots, options)
    if options.diagnosed:
        robots = [robot for robot in robots if is_diagnosed(options.out, robot)]
    # A later doctor may judge what an earlier one has answered, for it is asked nothing.
    is_asked = not all(is_diagnosed(options.out, robot) for robot in robots)
    doctor = check_doctor(options.out, is_locked) if is_asked else answered_by(options.out)
    there = gpus() if options.train_on else []
    judging = Judging(
        options.out,
        options.seed,
        options.episodes,
        options.share_episodes,
        Learning(options.minutes, there[0] if there else None, options=tuple(options.train))
        if options.train_on
        else None,
        options.oracle,
        tuple(options.leave),
        options.oracle_first,
    )
    until = time.time() + options.within
    begun = time.monotonic()
    if options.answered:
        rows = answered(robots, judging)
    else:
        rows = []
        with suppress(TimeOver), workers(options.jobs, options.cluster) as pool:
            queue = Queue(pool, AT_ONCE if options.cluster else options.jobs, until)
            rows = settle_all(robots, judging, queue, Turns(there, options.each_gpu))
            queue.check()  # ends what is under way
    found = {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "command": _command(options),
        "set": SET,
        "seed": options.seed,
        "drawn": options.robots,
        "key_sha256": sealed,
        "doctor_sha256": doctor,
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


def _before(robots: list[Robot], options: argparse.Namespace) -> dict:
    """What robots lose, before any doctor is asked."""
    judging = Judging(options.out, options.seed, options.episodes, 0, None)
    with workers(options.jobs, options.cluster) as pool:
        queue = Queue(pool, AT_ONCE if options.cluster else options.jobs, time.time() + options.within)
        return {"episodes": options.episodes, "rows": play_before(robots, judging, queue)}


def _command(options: argparse.Namespace) -> str:
    """What plays the same again."""
    said = (
        f"python -m np_blind.robots.set --robots {options.robots} --seed {options.seed} --episodes {options.episodes}"
    )
    said += f" --share-episodes {options.share_episodes} --minutes {options.minutes:g} --each-gpu {options.each_gpu}"
    said += ("" if options.train_on else " --no-training") + f" --oracle {options.oracle} --jobs {options.jobs}"
    said += " --oracle-first" if options.oracle_first else ""
    said += f" --leave {' '.join(options.leave)}" if options.leave else ""
    return said + (f" --train {' '.join(options.train)}" if options.train else "")


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Status 2: a key that is not the one whose hash was put down."""
    options = parse(arguments)
    interrupt_on_sigterm()
    os.environ.update(SINGLE_THREAD)  # of the processes that are started: an episode has a core
    try:
        told = seal(options) if options.seal else judge(options)
    except KeyboardInterrupt:
        print("interrupted; what is finished is kept, the same command goes on with the rest", file=sys.stderr)
        return INTERRUPTED
    except (SealError, OSError, ValueError, TimeOver) as error:
        print(f"robots.set: {error}", file=sys.stderr)
        return 2 if isinstance(error, SealError) else 1
    print(json.dumps(told))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
