"""How the driver's process ends, counted: `python tests/driver/ends.py 200` brings about each end so often.

    python tests/driver/ends.py 200 refused_fr3 sigint

The last line is one JSON object: of each end the expected status and how often each status came; -6 is SIGABRT.
"""

from __future__ import annotations

import json
import signal
import sys
import tempfile
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from graph_tools import Graph, Probe  # noqa: E402
from simulated_robot import SimulatedRobot, missing, simulated_robot  # noqa: E402

from np_common.cli import Progress, interrupt_on_sigterm  # noqa: E402
from np_ros import qos  # noqa: E402

NAME = "franka_driver"


@dataclass
class End:
    """One way to end. By itself with status 1, or by a signal with status 0; fault: what the robot is asked for before."""

    parameters: dict = field(default_factory=dict)
    protocol: int = 10
    signal: signal.Signals | None = None
    fault: str = ""


NOBODY = {"hostname": "127.0.0.250", "realtime": "ignore", "calibration": "none"}
ENDS = {
    "refused_fr3_hand": End({"robot": "fr3", "gripper": True}, protocol=5),
    "refused_fr3": End({"robot": "fr3", "gripper": False}, protocol=5),
    "refused_panda_hand": End({"robot": "panda", "gripper": True}),
    "refused_panda": End({"robot": "panda", "gripper": False}),
    "nobody": End({**NOBODY, "gripper": False}),
    "sigint": End(signal=signal.SIGINT),
    "sigterm": End(signal=signal.SIGTERM),
    "reflex_sigint": End(signal=signal.SIGINT, fault="reflex"),
    "lost_sigint": End(signal=signal.SIGINT, fault="mute"),
}


def bring_about(end: End, graph: Graph, probe: Probe, robot: SimulatedRobot, parameters: dict) -> int:
    """The status with which a driver has ended."""
    said = probe.messages["diagnostics"]
    said.clear()

    def state() -> str:
        values = (v for array in said for s in array.status if s.name == f"/{NAME}" for v in s.values)
        return next((value.value for value in reversed([*values]) if value.key == "state"), "")

    graph.run("np_franka", NAME, {**parameters, **end.parameters})
    if end.signal is None:
        probe.wait_until(lambda: graph.ended(NAME), what="the end of the driver")
        return graph.kill(NAME)  # it has ended: only its status is asked for
    probe.wait_until(lambda: state() in ("ready", "fault"), what="the driver's state")
    if state() == "fault":  # as the end before has left the robot
        probe.call(f"{NAME}/recover")
    probe.wait_until(lambda: state() == "ready", what="an arm that is held")
    if end.fault:
        robot.request(end.fault)
        probe.wait_until(lambda: state() == "fault", what="the fault")
    status = graph.kill(NAME, end.signal)
    if end.fault == "mute":
        robot.request("unmute")
    return status


def count(end: End, times: int) -> Counter[int]:
    """How often each status came."""
    counts, progress = Counter(), Progress(times, "ends")
    with (
        tempfile.TemporaryDirectory() as folder,
        Graph(Path(folder)) as graph,
        closing(Probe(graph)) as probe,
        simulated_robot(protocol=end.protocol) as (robot, parameters),
    ):
        probe.collect("diagnostics", DiagnosticArray, qos.EVENT)
        for number in range(times):
            progress.show(number)
            counts[bring_about(end, graph, probe, robot, parameters)] += 1
        progress.show(times)
    return counts


def main(arguments: list[str]) -> int:
    """Entry point. Status 1: the driver has ended otherwise than expected."""
    if why := missing():
        raise SystemExit(f"ends: {why}")
    interrupt_on_sigterm()
    times, found = int(arguments[0]) if arguments else 20, {}
    for name in arguments[1:] or ENDS:
        expected = 0 if ENDS[name].signal else 1
        found[name] = {"expected": expected, "ended": dict(count(ENDS[name], times))}
        print(json.dumps({name: found[name]}), flush=True)
    print(json.dumps(found))
    return 0 if all({*each["ended"]} == {each["expected"]} for each in found.values()) else 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
