"""`soak`: episodes in one graph, one after the other, in lockstep or for hours in real time; memory, handles and threads of every node have to stay flat."""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

from np_bringup.task_graph import KEYPOINT_SOURCES
from np_common.cli import INTERRUPTED, Parser, Progress, interrupt_on_sigterm, new_folder
from np_description.domains import DOMAINS
from np_description.phases import FAULT
from np_description.weights.provenance import origin

WARM = 10  # episodes until caches are full
_WRITTEN = 20  # episodes between two writings of what there is


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = Parser(prog="soak", description=__doc__.partition(": ")[2])
    p.add_argument("--episodes", type=int, default=2000, help="how many, in lockstep; %(default)s")
    p.add_argument("--hours", type=float, help="instead: for so long, in real time")
    p.add_argument("--domain", choices=list(DOMAINS), default="card", help="task family; %(default)s")
    p.add_argument("--seed", type=int, default=0, help="of the tasks; %(default)s")
    p.add_argument("--keypoints", choices=KEYPOINT_SOURCES, default="truth", help="%(default)s")
    p.add_argument("--memory", type=float, default=20.0, help="kB an episode that a node may grow by; %(default)g")
    p.add_argument("--out", type=Path, default=Path("runs/soak"), help="folder; a number is appended")
    return p


@dataclass
class SoakRun:
    """A soak test under way."""

    graph: dict[str, str]
    """Launch arguments."""
    allowed: float
    """Growth of a node's memory that is allowed, kB an episode."""
    revision: str
    """Of the code at the start."""
    began: float = field(default_factory=time.monotonic)
    """time.monotonic() at the start, s."""
    ends: dict[str, int] = field(default_factory=dict)
    """Number of episodes by declared end."""
    stops: int = 0
    """How often the backend stopped."""
    uses: dict[str, list] = field(default_factory=dict)
    """Use of each node after each episode."""

    @property
    def episodes(self) -> int:
        """Number of episodes so far."""
        return sum(self.ends.values())

    @property
    def seconds(self) -> float:
        """Wall time since the beginning."""
        return time.monotonic() - self.began

    def result(self, error: str) -> dict[str, object]:
        """The result so far. error: why the run is incomplete; empty where it is complete."""
        from np_evaluation.endurance.resources import find_growing, trend

        try:
            trends = {name: trend(values, WARM) for name, values in self.uses.items()}
        except ValueError as few:
            error, trends = error or str(few), {}
        return {
            "episodes": self.episodes,
            "ends": self.ends,
            "stops": self.stops,
            "growing": find_growing(trends, self.allowed),
            "error": error,
            "warm_up": WARM,
            "allowed_kB_per_episode": self.allowed,
            "nodes": {name: asdict(one) for name, one in trends.items()},
            "arguments": self.graph,
            "revision": self.revision,
            "wall_s": round(self.seconds, 1),
        }

    def write(self, path: Path, error: str) -> dict[str, object]:
        """Write the result and every use to `path`, in one step; the result."""
        result = self.result(error)
        uses = {name: [asdict(use) for use in values] for name, values in self.uses.items()}
        part = path.with_suffix(".part")
        part.write_text(json.dumps({**result, "uses": uses}))
        part.replace(path)
        return result


def episodes(run: SoakRun, options: argparse.Namespace, out: Path) -> None:
    """Run them. Raises NodeDied, GraphError, TimeoutError, OSError."""
    from np_evaluation.commands.common import running_graph
    from np_evaluation.endurance.resources import measure_use
    from np_ros.client.supervised_client import GraphError

    limit = 3600 * options.hours if options.hours else float("inf")
    progress = Progress(round(limit) if options.hours else options.episodes, "soak")
    with running_graph(run.graph, out / "log") as conductor:
        while run.seconds < limit and (options.hours or run.episodes < options.episodes):
            try:
                outcome = conductor.run_episode(until=run.began + limit)
            except GraphError:
                if not options.hours:
                    raise
                conductor.recover()  # in real time the backend stops where commands stay away too long
                run.stops += 1
                continue
            if run.seconds >= limit:
                break  # stopped on request, which is no end of an episode
            run.ends[outcome.declared] = run.ends.get(outcome.declared, 0) + 1
            if outcome.declared == FAULT:  # an end as others are; the next episode begins with an arm that is well
                conductor.recover()
            for name, pid in conductor.processes().items():
                run.uses.setdefault(name, []).append(measure_use(pid))
            if run.episodes % _WRITTEN == 0:
                run.write(out / "soak.json", f"not finished: {run.episodes} episodes so far")
            memory = sum(values[-1].memory for values in run.uses.values()) / 1e3
            progress.show(min(run.seconds, limit) if options.hours else run.episodes, f"{memory:.0f} MB")


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object. Status 1: something grows, or a node died."""
    options = parser().parse_args(arguments)
    if not options.hours and options.episodes < WARM + 10:
        parser().error(f"--episodes: expected at least {WARM + 10}, got {options.episodes}")
    if options.hours is not None and not options.hours > 0:
        parser().error(f"--hours: expected more than 0, got {options.hours:g}")
    from np_ros.client.supervised_client import GraphError
    from np_ros.processes.supervisor import NodeDied

    interrupt_on_sigterm()
    error = ""
    mode = "realtime" if options.hours else "lockstep"
    graph = {"domain": options.domain, "seed": str(options.seed), "keypoints": options.keypoints, "mode": mode}
    run = SoakRun(graph, options.memory, str(origin()["revision"]))
    try:
        out = new_folder(options.out)
    except OSError as failure:
        print(f"soak: {failure}", file=sys.stderr)
        return 1
    try:
        episodes(run, options, out)
    except KeyboardInterrupt:
        if run.episodes < WARM + 10:
            return INTERRUPTED
        error = f"interrupted after {run.episodes} episodes"
    except (NodeDied, GraphError, TimeoutError, LookupError, ValueError, OSError) as broken:
        error = str(broken)
        print(f"soak: {error}", file=sys.stderr)
    result = run.write(out / "soak.json", error)
    print(json.dumps(result))
    return 1 if error or result["growing"] else 0


if __name__ == "__main__":
    raise SystemExit(main())
