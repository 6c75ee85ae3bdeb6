"""`fuzz`: random and malformed messages on every topic of every node; none may die, and what is refused has to be counted."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

from np_common.cli import INTERRUPTED, Parser, Progress, interrupt_on_sigterm, new_folder
from np_description.domains import DOMAINS
from np_description.weights.provenance import origin


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = Parser(prog="fuzz", description=__doc__.partition(": ")[2])
    p.add_argument("--messages", type=int, default=10_000, help="on each topic, %(default)s")
    p.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="only these")
    p.add_argument("--domain", choices=list(DOMAINS), default="card", help="task family; %(default)s")
    p.add_argument("--seed", type=int, default=0, help="of the messages; %(default)s")
    p.add_argument("--out", type=Path, default=Path("runs/fuzz"), help="folder; a number is appended")
    return p


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object. Status 1: a node died or stopped publishing."""
    options = parser().parse_args(arguments)
    from np_bringup.task_graph import task_graph
    from np_evaluation.endurance.fuzz import Fuzzer
    from np_record.topics import TOPICS
    from np_ros.client.graph_client import GraphClient
    from np_ros.processes.graph import NodeSpec
    from np_ros.processes.supervisor import NodeDied, Supervisor

    known = {topic.name: topic for topic in TOPICS}
    unknown = sorted(set(options.topics) - set(known))
    if unknown:
        parser().error(f"--topics: expected some of {', '.join(known)}; got {', '.join(unknown)}")
    interrupt_on_sigterm()
    found, began = [], time.monotonic()
    try:
        out = new_folder(options.out)
        graph = task_graph({"domain": options.domain, "bag": str(out / "bag")})
        beside = [  # in an episode each would be a second publisher of its topic: they start when there are samples
            NodeSpec("np_sim_bridge", "keypoint_oracle", parameters={"mode": "lockstep", "domain": options.domain}),
            NodeSpec("np_bringup", "robot_state", parameters={"domain": options.domain}),
        ]
        by_name = {spec.name: spec for spec in [*graph, *beside]}
        with Supervisor(out / "log") as supervisor:

            def restart(name: str) -> None:
                supervisor.stop(name)
                supervisor.start([by_name[name]])

            supervisor.start(graph)
            os.environ.update(supervisor.environment)
            with closing(GraphClient("fuzz", domain_id=supervisor.domain_id, limit=120.0)) as peer:
                fuzzer = Fuzzer(peer, supervisor, restart, options.seed)
                peer.wait_until(lambda: {spec.name for spec in graph} <= fuzzer.speaking, what="every node")
                # A few real messages of an episode, to break.
                peer.call("sim_bridge/reset")
                peer.call("episode/start")
                peer.wait_until(lambda: fuzzer.has_samples("joint_trajectory", "target_pose"), what="the phase post")
                supervisor.start(beside)
                peer.wait_until(lambda: set(by_name) <= fuzzer.speaking, what="every node")
                topics = [known[name] for name in options.topics] or list(known.values())
                progress = Progress(len(topics), "fuzz")
                for number, topic in enumerate(topics):
                    progress.show(number, topic.name)
                    if (one := fuzzer.fuzz(topic, options.messages)) is not None:
                        found.append(one)
                progress.show(len(topics))
    except KeyboardInterrupt:
        return INTERRUPTED
    except (NodeDied, TimeoutError, LookupError, ValueError, OSError) as error:
        print(f"fuzz: {error}", file=sys.stderr)
        return 1
    for one in found:
        for name, words in one.died.items():
            print(f"fuzz: {one.topic}: {name}: {words}", file=sys.stderr)
    result = {
        "messages": sum(sum(one.sent.values()) for one in found),
        "topics": len(found),
        "nodes": sorted(by_name),
        "died": sorted({name for one in found for name in one.died}),
        "silent": sorted({name for one in found for name in one.silent}),
        "refused": sum(sum(one.refused.values()) for one in found),
        "by_topic": [asdict(one) for one in found],
        "seed": options.seed,
        "revision": origin()["revision"],
        "wall_s": round(time.monotonic() - began, 1),
    }
    (out / "fuzz.json").write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result))
    return 1 if result["died"] or result["silent"] else 0


if __name__ == "__main__":
    raise SystemExit(main())
