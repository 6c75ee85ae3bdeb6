"""`soak`: lockstep episodes in one graph, one after the other; memory, handles and threads of every node have to stay flat."""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict
from pathlib import Path

from np_bringup.task_graph import KEYPOINT_SOURCES
from np_description.domains import DOMAINS
from np_record.command import INTERRUPTED, Progress, interrupt_on_sigterm, new_folder, origin

WARM = 10  # episodes until caches are full


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(prog="soak", description=__doc__.partition(": ")[2])
    p.add_argument("--episodes", type=int, default=2000, help="how many, %(default)s")
    p.add_argument("--domain", choices=list(DOMAINS), default="card", help="task family; %(default)s")
    p.add_argument("--seed", type=int, default=0, help="of the tasks; %(default)s")
    p.add_argument("--keypoints", choices=KEYPOINT_SOURCES, default="truth", help="%(default)s")
    p.add_argument("--memory", type=float, default=20.0, help="kB an episode that a node may grow by; %(default)g")
    p.add_argument("--out", type=Path, default=Path("runs/soak"), help="folder; a number is appended")
    return p


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object. Status 1: something grows, or a node died."""
    options = parser().parse_args(arguments)
    if options.episodes < WARM + 10:
        parser().error(f"--episodes: expected at least {WARM + 10}, got {options.episodes}")
    from np_bringup.commands.common import running_graph
    from np_bringup.endurance.resources import growing, trend, use_of
    from np_ros.participant import GraphError
    from np_ros.supervisor import NodeDied

    interrupt_on_sigterm()
    out = new_folder(options.out)
    graph = {"domain": options.domain, "seed": str(options.seed), "keypoints": options.keypoints}
    uses: dict[str, list] = {}
    ends: dict[str, int] = {}
    progress, began, error = Progress(options.episodes, "soak"), time.monotonic(), ""
    try:
        with running_graph(graph, out / "log") as conductor:
            for number in range(options.episodes):
                outcome = conductor.run_episode()
                ends[outcome.declared] = ends.get(outcome.declared, 0) + 1
                for name, pid in conductor.processes().items():
                    uses.setdefault(name, []).append(use_of(pid))
                progress.show(number + 1, f"{sum(u[-1].memory for u in uses.values()) / 1e3:.0f} MB")
    except KeyboardInterrupt:
        if sum(ends.values()) < WARM + 10:
            return INTERRUPTED
        error = f"interrupted after {sum(ends.values())} episodes"
    except (NodeDied, GraphError, TimeoutError, OSError) as broken:
        error = str(broken)
        print(f"soak: {error}", file=sys.stderr)
    try:
        trends = {name: trend(values, WARM) for name, values in uses.items()}
    except ValueError as few:
        error, trends = error or str(few), {}
    result = {
        "episodes": sum(ends.values()),
        "ends": ends,
        "growing": growing(trends, options.memory),
        "error": error,
        "warm_up": WARM,
        "allowed_kB_per_episode": options.memory,
        "nodes": {name: asdict(one) for name, one in trends.items()},
        "arguments": graph,
        "revision": origin()["revision"],
        "wall_s": round(time.monotonic() - began, 1),
    }
    (out / "soak.json").write_text(json.dumps({**result, "uses": {n: [asdict(u) for u in v] for n, v in uses.items()}}))
    print(json.dumps(result))
    return 1 if error or result["growing"] else 0


if __name__ == "__main__":
    raise SystemExit(main())
