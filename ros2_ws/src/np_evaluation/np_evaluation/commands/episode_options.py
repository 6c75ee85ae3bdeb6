"""Options and exit of `evaluate` and `table3`."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from np_bringup.backends import ENGINES
from np_bringup.task_graph import KEYPOINT_SOURCES
from np_common.cli import INTERRUPTED, interrupt_on_sigterm
from np_common.parallel import HELP
from np_common.parallel import missing as missing_cluster
from np_physx_bridge.library import missing
from np_ros.processes.supervisor import NodeDied


def add_options(parser: argparse.ArgumentParser, *, jobs: int | None, out: str) -> None:
    """Options of how episodes are played. jobs, out: defaults of --jobs and --out."""
    parser.add_argument(
        "--seed", type=int, default=0, help="of tasks, scatter and sensors, together with the episode's number"
    )
    parser.add_argument("--engine", choices=list(ENGINES), default="mujoco", help="whose physics the robot has")
    parser.add_argument("--keypoints", choices=KEYPOINT_SOURCES, default="camera")
    parser.add_argument(
        "--contacts", type=int, default=1, help="how often a contact may be chosen in an episode; the paper: 1"
    )
    parser.add_argument("--weights", default="", help="folder with weights; default: the project's own")
    parser.add_argument("--jobs", type=int, default=jobs, help="graphs at a time (default: %(default)s)")
    parser.add_argument("--cluster", default="", help=HELP)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path(out),
        help="folder of results and logs; what is finished there is not played again (default: %(default)s)",
    )


def check_options(parser: argparse.ArgumentParser, options: argparse.Namespace, counts: Iterable[str]) -> None:
    """End the command with an error where an option of `add_options`, or one of the counts, is not usable."""
    for name in (*counts, "jobs", "contacts"):
        if getattr(options, name) < 1:
            parser.error(f"--{name}: expected at least 1, got {getattr(options, name)}")
    if problem := missing_cluster(options.cluster):
        parser.error(f"--cluster {problem}")
    if options.engine == "physx" and missing():
        parser.error(f"--engine physx: {missing()}")


def run_command(name: str, play: Callable[[], Mapping], summarize: Callable[[Mapping], tuple[Mapping, int]]) -> int:
    """Run the command called `name`; its exit status. summarize: gives what to print of the figures, as one JSON object, and the status."""
    interrupt_on_sigterm()
    try:
        figures = play()
    except KeyboardInterrupt:
        print("interrupted; finished episodes are kept, the same command goes on with the next", file=sys.stderr)
        return INTERRUPTED
    except (NodeDied, TimeoutError, LookupError, ValueError, OSError) as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 1
    last, status = summarize(figures)
    print(json.dumps(last))
    return status
