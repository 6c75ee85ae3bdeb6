"""What graph tests share: nodes as processes, a probe that collects what they say, waiting on conditions.

    def test_detector(graph, probe):
        probe.collect("keypoints", PointCloud2)
        graph.run("np_perception", "keypoint_detector", {"lockstep": True})
        probe.wait_until(lambda: probe.matched("camera/image_raw"))
        probe.publish("camera/image_raw", Image, message)
        probe.wait_until(lambda: probe.messages["keypoints"])

`graph` and `probe` are fixtures (conftest.py); both end what they started. An installed node is run as
installed, else from source. Nothing here sleeps: waiting is spinning.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Thread

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from sensor_msgs.msg import PointCloud2

from np_bringup.task_graph import task_graph
from np_description.message_arrays import stamp_nanoseconds
from np_ros import qos
from np_ros.client.connection_status import ConnectionStatus
from np_ros.client.graph_client import GraphClient
from np_ros.processes.graph import NodeSpec
from np_ros.processes.supervisor import Supervisor, find_installed_command

Overrides = Mapping[str, Mapping[str, object]]
ROOT = Path(__file__).resolve().parents[1]
TIMEOUT = 120.0  # s; only how long a broken graph takes to fail, never a requirement on speed


def command(package: str, executable: str) -> list[str]:
    """The installed executable, the node's module where the packages are used from source, or an example's file."""
    try:
        return find_installed_command(package, executable)
    except LookupError:
        if example := next((ROOT / package).glob(f"*{executable}.py"), None):
            return [sys.executable, str(example)]
        for module in (f"{package}.nodes.{executable}_node", f"{package}.commands.{executable}"):
            if importlib.util.find_spec(module):
                return [sys.executable, "-m", module]
        raise


def refusal(capfd, main: Callable[[list[str]], int], **parameters) -> str:
    """The lines that a node says which cannot start with these parameters. It runs in this process."""
    given = [
        f"{name}:={str(value).lower() if isinstance(value, bool) else value}" for name, value in parameters.items()
    ]
    assert main(["--ros-args", *(part for each in given for part in ("-p", each))]) == 1
    return capfd.readouterr().err


def card_specs(overrides: Overrides | None = None, *, leave_out=(), **arguments) -> list[NodeSpec]:
    """The nodes of the card graph for launch arguments; overrides: parameters by node."""
    overrides = overrides or {}
    return [
        replace(spec, parameters={**spec.parameters, **overrides.get(spec.name, {})})
        for spec in task_graph(arguments)
        if spec.name not in leave_out
    ]


class Graph(Supervisor):
    """A supervisor that also runs nodes from source."""

    def __init__(self, log_directory: Path):
        super().__init__(log_directory, locate=command)
        self._specs: dict[str, NodeSpec] = {}

    def start(self, specs: NodeSpec | Sequence[NodeSpec], environment: Mapping[str, str] | None = None) -> None:
        """As a supervisor does, remembering what was started."""
        specs = [specs] if isinstance(specs, NodeSpec) else list(specs)
        super().start(specs, environment)
        self._specs.update({spec.name: spec for spec in specs})

    def bring_to(self, specs: Sequence[NodeSpec]) -> set[str]:
        """Stop and start nodes until these run and no others; who runs as wanted is left alone. The names."""
        wanted = {spec.name: spec for spec in specs}
        other = [name for name in self.names if self.ended(name) or self._specs[name] != wanted.get(name)]
        if other:
            self.stop(*other)
        self.start([spec for name, spec in wanted.items() if name not in self.names])
        return set(wanted)

    def run_card(self, overrides: Overrides | None = None, *, leave_out=(), **arguments) -> set[str]:
        """Start the card graph, see `card_specs`. The names, for `Probe.wait_until_ready`."""
        specs = card_specs(overrides, leave_out=leave_out, **arguments)
        self.start(specs)
        return {spec.name for spec in specs}

    def run(
        self, package: str, executable: str, parameters: dict | None = None, *, name: str = "", remappings=()
    ) -> str:
        """Start one node; its name."""
        spec = NodeSpec(package, executable, name, parameters or {}, remappings)
        self.start(spec)
        return spec.name


class Probe(GraphClient):
    """A peer in the domain of a graph, whose nodes are watched while it waits."""

    def __init__(self, graph: Graph):
        self._graph = graph
        self._old = {key: os.environ.get(key) for key in graph.environment}
        os.environ.update(graph.environment)
        super().__init__("probe", domain_id=graph.domain_id, limit=TIMEOUT)

    def close(self) -> None:
        """Leave the graph."""
        super().close()
        for key, value in self._old.items():
            os.environ.pop(key) if value is None else os.environ.update({key: value})

    def wait_until_ready(self, names: set[str], timeout: float = 2 * TIMEOUT) -> None:
        """Until the named nodes are up, every publisher, the probe's too, has found its subscribers, and the nodes have found the probe."""
        links = ConnectionStatus(self.node)  # anew: it believes only what nodes say from now on
        self.wait_until(lambda: links.are_complete(names), timeout, f"{', '.join(sorted(names))}, all matched")
        self.be_found(*sorted(names))

    def be_found(self, *names: str) -> None:
        """Until the nodes have found what the probe has made so far: in what order it speaks on several topics, in that it is heard."""
        for name in names:
            self._services.be_found(name, TIMEOUT)

    def wait_until(
        self, condition: Callable[[], object], timeout: float | None = None, what: str = "the condition"
    ) -> None:
        """Spin until `condition()` holds. Fails with name and last lines of a node that ends meanwhile."""

        def spun() -> bool:
            if condition():
                return True
            self.spin_once()
            return bool(condition())

        self._graph.wait(spun, TIMEOUT if timeout is None else timeout, what)


def reset(probe: Probe) -> bool:
    """Whether `sim_bridge` takes a reset; if so, once its goal is in force: a start that came to `episode` before would be with the one of
    before, and end with it."""
    topic = "goal_keypoints"
    if topic not in probe.messages:
        probe.collect(topic, PointCloud2, qos.LATCHED)
    goals = probe.messages[topic]
    goals.clear()
    answer = probe.call("sim_bridge/reset")
    if answer.success:
        stamp = int(answer.message.split()[-2])  # "episode 0 at 100000000 ns"
        probe.wait_until(
            lambda: any(stamp_nanoseconds(g.header.stamp) == stamp for g in goals), what="the goal in force"
        )
    return answer.success


class Apart:
    """A node in a context of its own, which a thread of its own spins from `begin` to `close`."""

    def __init__(self, name: str, domain_id: int, **options):
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain_id)
        self.node = rclpy.create_node(name, context=self._context, **options)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = Thread(target=self._spin)

    def begin(self) -> None:
        """Serve from now on."""
        self._thread.start()

    def close(self) -> None:
        """Leave the graph."""
        rclpy.shutdown(context=self._context)
        self._thread.join()
        self.node.destroy_node()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass
