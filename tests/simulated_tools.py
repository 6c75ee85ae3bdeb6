"""`graph` and `probe` of graph_tools without processes: nodes run in this one, with the network and clock of the simulation test.

For tests of a node's behaviour, not of its transport (tests/nodes has the fixtures). Simulated time passes as fast as the nodes compute.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager

from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from np_evaluation.simtest.network import Network
from np_evaluation.simtest.process import Process, find_node_class
from np_evaluation.simtest.scheduler import SECOND, Disk, Locks, Scheduler, simulate_host
from np_ros import qos as profiles
from np_ros.client.connection_status import has_all_subscribers
from np_ros.processes.graph import NodeSpec

TIMEOUT = 120.0  # s of the nodes' time; only a failing node takes as long
_STEP = SECOND // 1000  # ns between two checks of a condition


class _Peer(Node):
    """The node of a probe."""

    def __init__(self):
        super().__init__("probe")


class InProcessGraph:
    """Nodes of the graph, each a simulated process."""

    def __init__(self):
        self.scheduler = Scheduler(0)
        self.network = Network(self.scheduler)
        self.lines: list[str] = []
        self._processes: dict[str, Process] = {}
        self._host = self.scheduler, Locks(), Disk()

    @property
    def names(self) -> list[str]:
        """The nodes that were started and not stopped."""
        return list(self._processes)

    @property
    def seconds(self) -> float:
        """Steady clock of the nodes, s."""
        return self.scheduler.now * 1e-9

    @contextmanager
    def host(self):
        """Replace the machine by the simulated one inside this context."""
        with simulate_host(*self._host):
            yield

    def process(self, spec: NodeSpec, kind: type[Node]) -> Process:
        """Start a process with a node of class `kind`."""
        with self.host():
            return Process(self.network, spec, kind, self.lines.append, lambda: self.names)

    def start(self, specs: Sequence[NodeSpec]) -> None:
        """Start nodes."""
        for spec in specs:
            self._processes[spec.name] = self.process(spec, find_node_class(spec))

    def bring_to(self, specs: Sequence[NodeSpec]) -> None:
        """Stop and start nodes until exactly these run; a node with an equal specification keeps running."""
        running = {name: process.spec for name, process in self._processes.items()}
        self.stop(*(name for name, spec in running.items() if spec not in specs))
        self.start([spec for spec in specs if spec.name not in self._processes])

    def run(self, package: str, executable: str, parameters: Mapping | None = None) -> str:
        """Start one node; returns its name."""
        self.start([spec := NodeSpec(package, executable, "", dict(parameters or {}))])
        return spec.name

    def stop(self, *names: str) -> None:
        """End nodes as an interrupt does."""
        for name in names:
            with self.host():
                self._processes.pop(name).stop()

    @contextmanager
    def frozen(self, name: str):
        """Freeze the node inside this context, as SIGSTOP does."""
        self._processes[name].freeze()
        try:
            yield
        finally:
            self._processes[name].thaw()

    def check(self) -> None:
        """Fail with the reason if a node has ended without a request."""
        for name, process in self._processes.items():
            assert process.is_alive, "\n".join([f"{name} ended: {process.died}", *self.lines[-12:]])

    def call(self, service: str, request) -> list:
        """Call a service; the returned list will hold the response."""
        responses = []
        self._processes[service.partition("/")[0]].call(service, request, responses.append)
        return responses


class InProcessProbe:
    """A peer of the nodes; see np_ros.client.graph_client."""

    def __init__(self, graph: InProcessGraph):
        self._graph = graph
        self._process = graph.process(NodeSpec("", "probe"), _Peer)
        self.node = self._process.node
        self._publishers: dict[str, object] = {}
        self.messages: dict[str, list] = defaultdict(list)

    def collect(
        self, topic: str, message_type: type, qos=profiles.LOCKSTEP, callback: Callable = lambda message: None
    ) -> list:
        """Append messages on `topic` to the returned list, `messages[topic]`, and call `callback` with each."""
        received = self.messages[topic]

        def keep(message):
            received.append(message)
            callback(message)

        self.node.create_subscription(message_type, topic, keep, qos)
        return received

    def advertise(self, topic: str, message_type: type, qos=profiles.LOCKSTEP):
        """Return the publisher on `topic`; the first call creates it."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(message_type, topic, qos)
        return self._publishers[topic]

    def publish(self, topic: str, message, qos=profiles.LOCKSTEP) -> None:
        """Publish `message` on `topic`."""
        self.advertise(topic, type(message), qos).publish(message)

    def matched(self, topic: str) -> bool:
        """Whether the probe's publisher on `topic` has a subscriber."""
        return self._publishers[topic].get_subscription_count() >= 1

    def all_acknowledged(self, topic: str) -> bool:
        """Whether all messages published on `topic` have arrived."""
        return self._publishers[topic].wait_for_all_acked(None)

    def call(self, service: str, request: bool | None = None):
        """Call a std_srvs service and return its response: Trigger, or SetBool if `request` is a bool."""
        content = SetBool.Request(data=request) if isinstance(request, bool) else Trigger.Request()
        responses = self._graph.call(service, content)
        self.wait_until(lambda: responses, what=f"a response of {service}")
        return responses[0]

    def wait_until_ready(self, names: set[str]) -> None:
        """Wait until every publisher has matched its subscribers; the named nodes must run."""
        assert names <= set(self._graph.names)
        publishers = self._graph.network.publishers
        self.wait_until(
            lambda: all(has_all_subscribers(self.node, p.topic_name, len(p.links)) for p in publishers),
            what="all matched",
        )

    def wait_until(
        self, condition: Callable[[], object], timeout: float = TIMEOUT, what: str = "the condition"
    ) -> None:
        """Run until `condition()` holds. Raises TimeoutError after `timeout` s, AssertionError with the reason if a node ends."""
        scheduler = self._graph.scheduler
        end = scheduler.now + round(timeout * SECOND)
        with self._graph.host():
            while not condition():
                self._graph.check()
                if scheduler.now > end:
                    raise TimeoutError(f"expected {what} within {timeout:g} s; it did not come")
                scheduler.run_until(scheduler.now + _STEP)
