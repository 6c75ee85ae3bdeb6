"""A simulated process with one node of the graph: its executor, its faults and its end."""

from __future__ import annotations

import importlib
import inspect
import math
from collections.abc import Callable

from rclpy.node import Node

from np_evaluation.simtest.endpoints import Publisher, Subscription
from np_evaluation.simtest.network import LEASE, Network
from np_evaluation.simtest.node import SimulatedNode, Timer
from np_record.bag_writer import BagWriter
from np_ros.node import check_known
from np_ros.processes.graph import NodeSpec

_MS = 1_000_000  # ns


class Process:
    """One process of a node from start to end; a restart makes another Process.

    spec: from the graph's table; node_class: the class to run; node_names(): the running nodes. died: why it ended without a request, ""
    if it did not.
    """

    def __init__(
        self, network: Network, spec: NodeSpec, node_class: type[Node], log: Callable[[str], None], node_names
    ):
        self.network, self.scheduler, self.spec, self.log, self.node_names = (
            network,
            network.scheduler,
            spec,
            log,
            node_names,
        )
        self.publishers: list[Publisher] = []
        self.subscriptions: list[Subscription] = []
        self.timers: list[Timer] = []
        self.services: dict[str, tuple[type, Callable]] = {}
        self.is_alive, self.is_frozen, self.died = True, False, ""
        self.began, self.killed_at = self.scheduler.now, math.inf
        self._is_running, self._free_at, self._wake_at = True, 0, None
        self._soon: list[Callable[[], None]] = []
        kind = type(node_class.__name__, (node_class, SimulatedNode), {"process": self})
        self.node = object.__new__(kind)
        try:
            self.node.__init__()
            check_known(self.node)
        except (ValueError, OSError) as error:  # like np_ros.node.run: log one line and end
            self._end(f"cannot start: {error}")
        self._is_running = False
        self.wake()

    def wake(self, when: int | None = None) -> None:
        """Schedule a turn at `when` ns, or now."""
        now = self.scheduler.now
        when = max(now, self._free_at, when or 0)
        if self._wake_at is None or when < self._wake_at or self._wake_at < now:
            self._wake_at = when
            self.scheduler.call_at(when, lambda: self._run(when))

    def call_soon(self, action: Callable[[], None]) -> None:
        """Run `action` in the node's thread."""
        self._soon.append(action)
        self.wake()

    def occupy(self, ns: int) -> None:
        """Let the running callback take `ns`; no other callback runs before it ends."""
        self._free_at = max(self._free_at, self.scheduler.now + ns)

    def freeze(self) -> None:
        """Suspend it as SIGSTOP does."""
        self.is_frozen = True

    def thaw(self) -> None:
        """Resume it as SIGCONT does."""
        self.is_frozen = False
        for subscription in self.subscriptions:
            for link in subscription.links:
                link.thaw()
        self.wake()

    def kill(self) -> None:
        """End it as SIGKILL does; the others detect this when its lease expires."""
        if self.is_alive:
            self.is_alive, self.killed_at = False, self.scheduler.now
            if isinstance(writer := getattr(self.node, "_writer", None), BagWriter):
                writer._queue.kill()
            self.scheduler.call_after(LEASE * _MS, lambda: self.network.remove(self))

    def stop(self) -> None:
        """End it as SIGINT does: after the running callback and before any other."""
        if self.is_alive and self._is_running:
            self.scheduler.call_after(_MS, self.stop)
        elif self.is_alive:
            self._is_running, why = True, ""
            try:
                self.node.destroy_node()
            except SystemExit as ended:  # from a recorder whose disk is full when it closes its bag
                why = f"status {ended}"
            self._end(why)

    def call(self, service: str, request, on_response: Callable[[object], None]) -> None:
        """Call one of its services; `on_response` receives the response unless the process dies first."""
        kind, callback = self.services[service]

        def serve() -> None:
            response = callback(request, kind.Response())
            self.scheduler.call_after(self.network.draw_delay("", None), lambda: on_response(response))

        self.scheduler.call_after(self.network.draw_delay("", None), lambda: self.call_soon(serve))

    def _end(self, why: str) -> None:
        self.is_alive, self.died = False, why
        self.network.remove(self)
        if why:
            self.log(f"{self.spec.name}: ended: {why}")

    def _run(self, when: int) -> None:
        """Run one turn of np_ros.low_latency.spin: timers, one message of each subscription in order of creation, services."""
        if when != self._wake_at:
            return  # an earlier turn replaced this one
        self._wake_at = None
        if not self.is_alive or self._is_running or self.is_frozen:
            return
        if self.scheduler.now < self._free_at:
            return self.wake()
        self._is_running = True
        try:
            self._turn()
        except SystemExit:
            if self.is_alive:
                self._end("status 1")
        except Exception as error:  # noqa: BLE001  any exception of a callback ends its process
            where = inspect.trace()[-1]
            self._end(f"crash: {type(error).__name__}: {error} ({where.filename.rsplit('/', 1)[-1]}:{where.lineno})")
        self._is_running = False
        if self.is_alive:
            self._sleep()

    def _turn(self) -> None:
        now = self.scheduler.now
        for timer in [each for each in self.timers if (due := each.due) is not None and due <= now]:
            if timer.due is not None and timer.due <= now:
                timer.call()
        for subscription in self._list_ready():
            subscription.run()
        soon, self._soon = self._soon, []
        for action in soon:
            action()

    def _list_ready(self) -> list[Subscription]:
        return [each for each in self.subscriptions if each.waiting and not each.is_polled]

    def _sleep(self) -> None:
        if self._soon or self._list_ready():
            return self.wake()
        if dues := [due for timer in self.timers if (due := timer.due) is not None]:
            self.wake(min(dues))


def find_node_class(spec: NodeSpec) -> type[Node]:
    """Find the class of a node of the graph."""
    module = importlib.import_module(f"{spec.package}.nodes.{spec.executable}_node")
    return next(
        each
        for each in vars(module).values()
        if inspect.isclass(each) and issubclass(each, Node) and each.__module__ == module.__name__
    )
