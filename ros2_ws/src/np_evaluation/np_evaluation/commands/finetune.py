"""`finetune BAG... --domain DOMAIN --out DIR`: from recordings of the suites to recovered success.

Diagnoses the recordings (`diagnose`, and `diagnose_task` where one has the task suite). Predicts success with the patch and without it,
and how much of it each effect costs. Trains the policies on with the patch, and judges them again. The same command goes on where it ended.
The last line printed is one JSON object; DIR gets finetune.html, finetune.json, patch.yaml and weights/.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path

from sim2real.effects.patch import Patch, load_patch

from np_common.cli import INTERRUPTED, Parser, interrupt_on_sigterm
from np_common.parallel import SINGLE_THREAD, workers
from np_description.domains import DOMAINS
from np_description.objects.choice import DEFAULT, embed_object_text
from np_evaluation.finetune.learning import Learning, list_gpus
from np_evaluation.finetune.rollouts import RolloutCell, text_of
from np_evaluation.finetune.stages import FinetuneSettings, check_episodes, diagnose_bags, run_finetune
from np_physx_bridge.library import missing

MOST_MINUTES = 5.0


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="finetune", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bags", nargs="*", type=Path, metavar="BAG", help="recordings of `excite`, of either suite")
    parser.add_argument("--patch", type=Path, help="patch.yaml in place of recordings: the diagnosis is there already")
    parser.add_argument("--domain", choices=list(DOMAINS), default="wall")
    parser.add_argument("--object", default=DEFAULT, help="a row of the domain's table of objects, or a .yaml file")
    parser.add_argument("--episodes", type=int, default=100, help="of every figure (default: %(default)s)")
    parser.add_argument(
        "--share-episodes", type=int, default=50, help="of every subset of the effects (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of tasks and training")
    parser.add_argument("--contacts", type=int, default=1, help="how often a contact may be chosen in an episode")
    parser.add_argument("--minutes", type=float, default=5.0, help=f"of training, up to {MOST_MINUTES:g}")
    parser.add_argument("--weights", default="", help="folder of weights to go on from; default: the project's own")
    parser.add_argument(
        "--reality",
        metavar="physx|FILE.yaml",
        help="judge by another engine, with the effects of a file: in the lab's place where there is none",
    )
    parser.add_argument("--train", nargs=argparse.REMAINDER, default=[], help="further options of np_training.train")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("runs/finetune"))
    options = parser.parse_args(arguments)
    if bool(options.bags) == bool(options.patch):
        parser.error("expected recordings, or --patch")
    if not 0 < options.minutes <= MOST_MINUTES:
        parser.error(f"--minutes: expected up to {MOST_MINUTES:g}, got {options.minutes:g}")
    if min(options.episodes, options.share_episodes, options.jobs, options.contacts) < 1:
        parser.error("--episodes, --share-episodes, --jobs, --contacts: expected at least 1")
    if options.reality and (problem := missing()):
        parser.error(f"--reality: {problem}")
    return options


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Status 1: the diagnosis refuses, training fails, a recording is of another domain's episodes, or files are of other results."""
    options = parse(arguments)
    interrupt_on_sigterm()
    begun, out = time.monotonic(), options.out.resolve()
    try:
        robot = RolloutCell(
            options.domain,
            weights=str(Path(options.weights).resolve()) if options.weights else "",
            object=embed_object_text(options.domain, options.object),
            seed=options.seed,
            contacts=options.contacts,
        )
        check_episodes(options.bags, options.domain)
        patch = load_patch(options.patch) if options.patch else diagnose_bags(options.bags, out)
        there = list_gpus()
        what = FinetuneSettings(
            robot,
            out,
            _reality(robot, options.reality),
            options.episodes,
            options.share_episodes,
            beside=bool(there),  # where there is no GPU the cores play first
        )
        how = Learning(options.minutes, there[0] if there else None, options.seed, tuple(options.train))
        os.environ.update(SINGLE_THREAD)  # of the processes that are started: each has a core
        with workers(options.jobs) as pool:
            result = run_finetune(what, patch, how, pool)
    except KeyboardInterrupt:
        print("interrupted; what is finished is kept, the same command goes on with the rest", file=sys.stderr)
        return INTERRUPTED
    except (OSError, ValueError) as error:
        print(f"finetune: {error}", file=sys.stderr)
        print(json.dumps({"error": str(error)}))
        return 1
    from np_evaluation.finetune.page import render, sentence  # drawing is slow to import

    result["wall_s"] = round(time.monotonic() - begun, 1)
    report = out / "finetune.html"
    report.write_text(render(result, patch, out), encoding="utf-8")
    print(sentence(result))
    print(json.dumps({name: value for name, value in result.items() if name != "played"} | {"report": str(report)}))
    return 0


def _reality(robot: RolloutCell, asked: str | None) -> RolloutCell | None:
    """PhysX in the lab's place, with the effects of a file."""
    if not asked:
        return None
    effects = Patch() if asked == "physx" else load_patch(asked)
    return RolloutCell(robot.domain, "physx", text_of(effects), robot.weights, robot.object, robot.seed, robot.contacts)


if __name__ == "__main__":
    raise SystemExit(main())
