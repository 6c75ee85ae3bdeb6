"""`graph` and `probe` of graph_tools without processes: nodes run in this one, on the network and in the time of the simulation test.

For tests of what a node does, not of how its messages travel (tests/nodes has the fixtures). A second of the nodes' time takes as long as their work: nobody waits. A process ends with `stop`, is held with `freeze`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager

from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from np_evaluation.simtest.network import Network
from np_evaluation.simtest.process import Process, node_class
from np_evaluation.simtest.scheduler import SECOND, Disk, Locks, Scheduler, simulate_host
from np_ros import qos as profiles
from np_ros.client.connection_status import has_all_subscribers
from np_ros.processes.graph import NodeSpec

TIMEOUT = 120.0  # s of the nodes' time; only how long a broken node takes to fail
_STEP = SECOND // 1000  # ns between two looks at a condition


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
        """The nodes started and not stopped."""
        return list(self._processes)

    @property
    def seconds(self) -> float:
        """s of the nodes' steady clock."""
        return self.scheduler.now * 1e-9

    @contextmanager
    def host(self):
        """What runs inside finds the simulated machine."""
        with simulate_host(*self._host):
            yield

    def process(self, spec: NodeSpec, kind: type[Node]) -> Process:
        """A process of a class of nodes."""
        with self.host():
            return Process(self.network, spec, kind, self.lines.append, lambda: self.names)

    def start(self, specs: Sequence[NodeSpec]) -> None:
        """Start nodes."""
        for spec in specs:
            self._processes[spec.name] = self.process(spec, node_class(spec))

    def bring_to(self, specs: Sequence[NodeSpec]) -> None:
        """Stop and start nodes until these run and no others; who runs as wanted is left alone."""
        running = {name: process.spec for name, process in self._processes.items()}
        self.stop(*(name for name, spec in running.items() if spec not in specs))
        self.start([spec for spec in specs if spec.name not in self._processes])

    def run(self, package: str, executable: str, parameters: Mapping | None = None) -> str:
        """Start one node; its name."""
        self.start([spec := NodeSpec(package, executable, "", dict(parameters or {}))])
        return spec.name

    def stop(self, *names: str) -> None:
        """End nodes as an interrupt does, and forget them."""
        for name in names:
            with self.host():
                self._processes.pop(name).stop()

    @contextmanager
    def frozen(self, name: str):
        """The node stands still inside, as after SIGSTOP."""
        self._processes[name].freeze()
        try:
            yield
        finally:
            self._processes[name].thaw()

    def check(self) -> None:
        """Fail with the reason if a node has ended by itself."""
        for name, process in self._processes.items():
            assert process.is_alive, "\n".join([f"{name} ended: {process.died}", *self.lines[-12:]])

    def ask(self, service: str, request) -> list:
        """Ask a service; the list will hold the response."""
        answers = []
        self._processes[service.partition("/")[0]].call(service, request, answers.append)
        return answers


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
        """Keep what comes on `topic` in `messages[topic]`, the list returned, and hand it to `callback`."""
        received = self.messages[topic]

        def keep(message):
            received.append(message)
            callback(message)

        self.node.create_subscription(message_type, topic, keep, qos)
        return received

    def advertise(self, topic: str, message_type: type, qos=profiles.LOCKSTEP):
        """The publisher on `topic`, made at the first call."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(message_type, topic, qos)
        return self._publishers[topic]

    def publish(self, topic: str, message, qos=profiles.LOCKSTEP) -> None:
        """Publish `message` on `topic`."""
        self.advertise(topic, type(message), qos).publish(message)

    def matched(self, topic: str) -> bool:
        """Whether our publisher on `topic` has a subscriber."""
        return self._publishers[topic].get_subscription_count() >= 1

    def is_heard(self, topic: str) -> bool:
        """Whether all that was published on `topic` has arrived."""
        return self._publishers[topic].wait_for_all_acked(None)

    def call(self, service: str, request: bool | None = None):
        """The response of a std_srvs service: Trigger, or SetBool where `request` is a bool."""
        content = SetBool.Request(data=request) if isinstance(request, bool) else Trigger.Request()
        answers = self._graph.ask(service, content)
        self.wait_until(lambda: answers, what=f"an answer of {service}")
        return answers[0]

    def wait_until_ready(self, names: set[str]) -> None:
        """Until the named nodes run and every publisher has found its subscribers."""
        assert names <= set(self._graph.names)
        publishers = self._graph.network.publishers
        self.wait_until(
            lambda: all(has_all_subscribers(self.node, p.topic_name, len(p.links)) for p in publishers),
            what="all matched",
        )

    def wait_until(
        self, condition: Callable[[], object], timeout: float = TIMEOUT, what: str = "the condition"
    ) -> None:
        """Let time pass until `condition()` holds. Fails with the reason of a node that ends meanwhile."""
        scheduler = self._graph.scheduler
        end = scheduler.now + round(timeout * SECOND)
        with self._graph.host():
            while not condition():
                self._graph.check()
                if scheduler.now > end:
                    raise TimeoutError(f"expected {what} within {timeout:g} s; it did not come")
                scheduler.run_until(scheduler.now + _STEP)
