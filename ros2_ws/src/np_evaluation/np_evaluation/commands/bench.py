"""`bench`: how fast the graph and its parts are, each figure beside a peer measured in the same run."""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from dataclasses import replace
from pathlib import Path

from np_bringup.task_graph import LOOP_PRIORITY, task_graph
from np_common.cli import INTERRUPTED, Parser, Progress, interrupt_on_sigterm, new_folder
from np_description.domains import find_domain
from np_ros.processes.graph import NodeSpec
from np_ros.processes.supervisor import NodeDied, Supervisor

DOMAIN, PACKAGE = "card", "np_evaluation"
FRAMES, FRAME_RATE = 500, 30


def lockstep_factor(weights: str, keypoints: str, logs: Path) -> dict[str, object]:
    """Simulated by wall time of one whole episode in lockstep, planning included."""
    from np_evaluation.commands.common import running_graph  # slow, as what the functions below import

    with running_graph({"keypoints": keypoints, "weights": weights}, logs) as conductor:
        began = time.monotonic()
        outcome = conductor.run_episode()
        wall = time.monotonic() - began
    return {
        "factor": round(outcome.duration / wall, 2),
        "simulated_s": round(outcome.duration, 1),
        "declared": f"{outcome.declared}: {outcome.reason}".rstrip(": "),
    }


def graph_round_trip(weights: str, seconds: float, logs: Path) -> dict[str, object]:
    """The control loop in real time with every node at work: camera, detector, planner, policies."""
    return work_in_real_time([*task_graph({"mode": "realtime", "weights": weights}), observer(logs)], seconds, logs)


def observer(logs: Path, *remappings: tuple[str, str]) -> NodeSpec:
    """The node that measures a graph, with the priority of the backend whose topics it receives.

    With less it would count its own wait for a core: on two busy cores, ten times as many late states as the loop has.
    """
    out = {"out": str(logs / "round_trip.json")}
    return NodeSpec(PACKAGE, f"{PACKAGE}.bench.round_trip", "round_trip", out, remappings, realtime=LOOP_PRIORITY)


def work_in_real_time(specs: list[NodeSpec], seconds: float, logs: Path) -> dict[str, object]:
    """Run episodes for so many seconds on a graph with a round_trip.

    Returns the figures of round_trip, `episodes`, `stops` by the guards, and `cores`: how much of a core each process used.
    """
    from np_evaluation.nodes.episode_runner_node import EpisodeRunner
    from np_ros.client.supervised_client import GraphError

    episodes = stops = 0
    with Supervisor(logs) as supervisor:
        supervisor.start(specs)
        with EpisodeRunner(supervisor, find_domain(DOMAIN), lockstep=False) as conductor:
            conductor.wait_until_ready(specs)
            conductor.call("round_trip/start")
            began, used = time.monotonic(), _processor_time(conductor)
            deadline = began + seconds
            while time.monotonic() < deadline:
                try:
                    conductor.run_episode(until=deadline)
                    episodes += 1
                except GraphError:  # the backend stopped, because commands stayed away too long
                    conductor.recover()
                    stops += 1
            took, now = time.monotonic() - began, _processor_time(conductor)
            shares = {name: round((now[name] - used[name]) / took, 3) for name in now}
    measured = json.loads((logs / "round_trip.json").read_text())
    return {
        **measured,
        "episodes": episodes,
        "stops": stops,
        "cores": {**shares, "all": round(sum(shares.values()), 3)},
    }


def _processor_time(conductor) -> dict[str, float]:
    """Processor time s by node, and of this process, which gives the tasks."""
    from np_evaluation.endurance.resources import processor_seconds

    pids = {**conductor.processes(), "bench": os.getpid()}
    return {name: processor_seconds(pid) for name, pid in pids.items()}


def play_frames(weights: str, frames: int, logs: Path) -> dict[str, object]:
    """Play so many images of a recorded episode, over and over at their own 30 Hz, through the detector.

    The graph around it runs in real time, and its policies use true keypoints.
    """
    from np_evaluation.commands.common import running_graph

    recording = {"keypoints": "camera", "weights": weights, "bag": str(logs / "images"), "record_at_start": "false"}
    with running_graph(recording, logs / "record") as conductor:
        bag = conductor.start_recording()
        conductor.run_episode()
        conductor.stop_recording()
    image, info, keypoints = (
        (name, f"played/{name}") for name in ("camera/image_raw", "camera/camera_info", "keypoints")
    )
    detector = {"mode": "realtime", "weights": weights}
    player = {"source": bag, "repeat": True}
    specs = [
        *task_graph({"mode": "realtime", "keypoints": "truth", "weights": weights}),
        replace(NodeSpec("np_perception", "camera_player", "", player, (image, info)), nice=10),
        replace(NodeSpec("np_perception", "keypoint_detector", "", detector, (image, keypoints)), nice=10),
        observer(logs, info, keypoints),
    ]
    return work_in_real_time(specs, frames / FRAME_RATE, logs)


def echo_round_trip(seconds: float, logs: Path) -> dict[str, object]:
    """The peer: the same backend and measurement, an echo for a controller, and nothing else at work."""
    from np_evaluation.nodes.episode_runner_node import EpisodeRunner

    backend = {"mode": "realtime", "camera": False}
    specs = [
        NodeSpec("np_sim_bridge", "sim_bridge", parameters=backend, realtime=LOOP_PRIORITY),
        NodeSpec(PACKAGE, f"{PACKAGE}.bench.echo", "echo", realtime=LOOP_PRIORITY),
        observer(logs),
    ]
    with Supervisor(logs) as supervisor:
        supervisor.start(specs)
        with EpisodeRunner(supervisor, find_domain(DOMAIN), lockstep=False) as conductor:
            conductor.wait_until_ready(specs, services=())
            conductor.call("round_trip/start")
            conductor.listen(seconds)
    return json.loads((logs / "round_trip.json").read_text())


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object."""
    parser = Parser(prog="bench", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the real-time measurement")
    parser.add_argument("--weights", default="", help="folder with weights; default: the project's own")
    parser.add_argument("--out", type=Path, default=Path("runs/bench"), help="folder for logs; a number is appended")
    options = parser.parse_args(arguments)
    from np_evaluation.bench import figures
    from np_ros.client.supervised_client import GraphError

    interrupt_on_sigterm()
    logs = new_folder(options.out)
    domain = find_domain(DOMAIN)
    parts = {
        "simulation": lambda: figures.simulation_figures(domain),
        "static": figures.static_figures,
        "one_process": lambda: figures.in_process_figures(find_domain("wall"), options.weights),
        "renderer": lambda: figures.renderer_figures(domain),
        "detector": lambda: figures.detector_figures(domain, options.weights),
        "policy": lambda: figures.policy_figures(domain, options.weights),
        "planner": lambda: figures.planner_figures(domain),
        "lockstep": lambda: lockstep_factor(options.weights, "camera", logs / "lockstep"),
        "lockstep_without_camera": lambda: lockstep_factor(options.weights, "truth", logs / "truth"),
        "round_trip": lambda: graph_round_trip(options.weights, options.seconds, logs / "realtime"),
        "played_frames": lambda: play_frames(options.weights, FRAMES, logs / "frames"),
        "round_trip_peer_echo_alone": lambda: echo_round_trip(min(20.0, options.seconds), logs / "echo"),
    }
    result: dict[str, object] = {"machine": f"{platform.machine()}, {os.cpu_count()} cores"}
    progress, status = Progress(len(parts), "bench"), 0
    for number, (name, measure) in enumerate(parts.items()):
        progress.show(number, name)
        try:
            result[name] = measure()
        except KeyboardInterrupt:
            return INTERRUPTED
        except (NodeDied, GraphError, TimeoutError, LookupError, ValueError, OSError) as error:
            print(f"bench: {name}: {error}", file=sys.stderr)
            result[name], status = {"error": str(error)}, 1
    progress.show(len(parts))
    (logs / "bench.json").write_text(json.dumps(result, indent=1))
    print(json.dumps(result))
    return status


if __name__ == "__main__":
    raise SystemExit(main())
