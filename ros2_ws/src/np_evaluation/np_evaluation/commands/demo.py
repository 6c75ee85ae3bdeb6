"""`demo`: episodes through the graph, in lockstep, with bag, report and video."""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from np_bringup.task_graph import KEYPOINT_SOURCES
from np_common.cli import INTERRUPTED, Parser, Progress, interrupt_on_sigterm, new_folder
from np_common.intervals import wilson_interval
from np_description.domains import DOMAINS, find_domain
from np_description.objects.choice import DEFAULT, embed_object_text
from np_description.weights.provenance import origin
from np_ros.processes.supervisor import NodeDied

if TYPE_CHECKING:  # what is slow to import comes after the options are read
    from np_description.phases import PhaseState
    from np_record.outcome import Outcome


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="demo", description=__doc__)
    parser.add_argument("--domain", choices=list(DOMAINS), default="card")
    parser.add_argument("--object", default=DEFAULT, help="a row of the domain's table of objects, or a .yaml file")
    parser.add_argument("--episodes", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0, help="names the tasks, together with the episode's number")
    parser.add_argument("--keypoints", choices=KEYPOINT_SOURCES, default="camera")
    parser.add_argument("--image-rate", type=int, default=30, help="images a second of simulated time")
    parser.add_argument("--weights", default="", help="folder with weights; default: the project's own")
    parser.add_argument("--out", type=Path, default=Path("runs/demo"), help="folder to make; a number is appended")
    options = parser.parse_args(arguments)
    if options.episodes < 1:
        parser.error(f"--episodes: expected at least 1, got {options.episodes}")
    try:
        options.object = embed_object_text(options.domain, options.object)
    except ValueError as error:
        parser.error(str(error))
    return options


def run_episodes(options: argparse.Namespace, out: Path, bags: list[str], outcomes: list[Outcome]) -> None:
    """Run the episodes; bags and outcomes are appended to as they come, and so survive an interruption."""
    from np_evaluation.commands.common import running_graph
    from np_record.outcome import note_position_only

    domain = find_domain(options.domain)
    arguments = {
        "domain": options.domain,
        "object": options.object,
        "seed": str(options.seed),
        "keypoints": options.keypoints,
        "image_rate": str(options.image_rate),
        "weights": options.weights,
        "bag": str(out / "episode"),
        "record_at_start": "false",
        "run_info": json.dumps(origin(options.weights)),
    }
    clock = time.monotonic()
    last = [-1.0]

    def show_phase(state: PhaseState, seconds: float) -> None:
        say(f"  {seconds:5.1f} s  {state}")

    def show_tick(seconds: float) -> None:
        if sys.stderr.isatty() and seconds - last[0] >= 0.5 or seconds < last[0]:
            last[0] = seconds
            print(
                f"\r\x1b[K  {seconds:5.1f} s simulated, {time.monotonic() - clock:.0f} s of wall time",
                end="",
                file=sys.stderr,
                flush=True,
            )

    say(f"starting the graph; logs are in {out / 'log'}")
    with running_graph(arguments, out / "log", on_phase=show_phase, on_tick=show_tick) as conductor:
        say(f"every node is up after {time.monotonic() - clock:.1f} s")
        for number in range(options.episodes):
            say(f"episode {number + 1} of {options.episodes}")
            bags.append(conductor.start_recording())
            outcome = conductor.run_episode()
            conductor.stop_recording()
            outcomes.append(outcome)
            say(
                f"  {'SUCCESS' if outcome.success else 'FAILURE'} by the true pose: "
                f"{100 * outcome.distance:.2f} cm, {np.degrees(outcome.angle):.1f} deg{note_position_only(domain)} from the goal "
                f"after {outcome.duration:.1f} s"
            )


def make_report(out: Path, bags: list[str]) -> list[str]:
    """Report and videos of the bags; the paths of the videos."""
    from np_record.report.episodes import make_section, write_report

    progress = Progress(len(bags), "report")
    sections, videos = [], []
    for number, bag in enumerate(bags):
        video = out / f"{Path(bag).name}.webm"
        sections.append(make_section(bag, video))
        videos += [str(video)] if video.exists() else []
        progress.show(number + 1)
    write_report(out / "report.html", sections)
    return videos


def say(text: str) -> None:
    """A line on standard output, over a half-drawn line of progress."""
    if sys.stderr.isatty():
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)
    print(text, flush=True)


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object."""
    options = parse(arguments)
    from np_ros.client.supervised_client import GraphError

    interrupt_on_sigterm()
    try:
        out = new_folder(options.out)
    except OSError as failure:
        print(f"demo: {failure}", file=sys.stderr)
        return 1
    bags: list[str] = []
    outcomes: list[Outcome] = []
    began = time.monotonic()
    status, error, videos = 0, "", []
    try:
        run_episodes(options, out, bags, outcomes)
    except KeyboardInterrupt:
        status, error = INTERRUPTED, "interrupted"
    except (NodeDied, GraphError, TimeoutError, LookupError, ValueError, OSError) as failure:
        status, error = 1, str(failure)
        print(f"demo: {error}", file=sys.stderr)
    finished = bags[: len(outcomes)]
    if finished and status != INTERRUPTED:
        videos = make_report(out, finished)
    successes = sum(outcome.success for outcome in outcomes)
    print(
        json.dumps(
            {
                "success": successes / len(outcomes) if outcomes else None,
                "ci95": wilson_interval(successes, len(outcomes)),
                "episodes": len(outcomes),
                "outcomes": [o.declared + (f": {o.reason}" if o.reason else "") for o in outcomes],
                "bags": bags,
                "report": str(out / "report.html") if (out / "report.html").exists() else "",
                "videos": videos,
                "error": error,
                "wall_s": round(time.monotonic() - began, 1),
            }
        )
    )
    return status


if __name__ == "__main__":
    raise SystemExit(main())
