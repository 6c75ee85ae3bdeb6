"""A process with a node in it, whose class is the graph's own: a stand-in for rclpy's Node below it runs on the simulated network."""

from __future__ import annotations

import importlib
import inspect
import math
from collections.abc import Callable
from types import SimpleNamespace

from builtin_interfaces.msg import Time
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter

from np_evaluation.simtest.network import LEASE, Network, Publisher, Subscription
from np_ros.low_latency.latest_message import PolledCallbackGroup
from np_ros.node import check_known
from np_ros.processes.graph import NodeSpec

SECOND = 1_000_000_000
_MS = 1_000_000


class Timer:
    """As rclpy's. A timer of the node's own clock goes by the wall clock, which may jump."""

    def __init__(self, process: Process, period: float, callback: Callable[[], None], is_steady: bool):
        self._process, self.callback, self._is_steady = process, callback, is_steady
        self._period = round(period * SECOND)
        self._next: int | None = None
        self.reset()

    def reset(self) -> None:
        """Run a period from now on."""
        self._next = self._clock() + self._period
        self._process.wake(self.due)

    def cancel(self) -> None:
        """Do not run until `reset`."""
        self._next = None

    def is_canceled(self) -> bool:
        """Whether it does not run."""
        return self._next is None

    @property
    def due(self) -> int | None:
        """ns of the steady clock at which it runs next, None for never."""
        return None if self._next is None else self._next - self._clock() + self._process.scheduler.now

    def call(self) -> None:
        """Run the callback; periods that were missed are left out."""
        late = self._clock() - self._next
        self._next += self._period * (1 + late // self._period)
        self.callback()

    def _clock(self) -> int:
        return self._process.scheduler.now if self._is_steady else self._process.scheduler.wall


class SimulatedNode(Node):
    """Stands in for rclpy's Node: see `Process`, which sets `process` before the constructor runs."""

    process: Process

    def __init__(self, name: str):
        self._name = name
        self._parameter_overrides = {
            key: Parameter(key, value=value) for key, value in self.process.spec.parameters.items()
        }
        self._known: dict[str, object] = {}

    publishers = property(lambda self: self.process.publishers)
    subscriptions = property(lambda self: self.process.subscriptions)
    timers = property(lambda self: self.process.timers)
    context = property(lambda self: SimpleNamespace(ok=lambda: self.process.is_alive))

    def get_name(self) -> str:
        return self._name

    def get_namespace(self) -> str:
        return "/"

    def get_fully_qualified_name(self) -> str:
        return f"/{self._name}"

    def get_logger(self):
        def log(text: str, **_) -> None:
            self.process.log(f"{self._name}: {text}")

        return SimpleNamespace(debug=log, info=log, warn=log, warning=log, error=log, fatal=log)

    def get_clock(self):
        seconds, rest = divmod(self.process.scheduler.wall, SECOND)
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: Time(sec=seconds, nanosec=rest)))

    def resolve_topic_name(self, topic: str) -> str:
        return topic if topic.startswith("/") else f"/{topic}"

    def declare_parameter(self, name: str, default, descriptor: ParameterDescriptor):
        given = self._parameter_overrides.get(name)
        value = default if given is None else given.value
        if type(value) is not type(default):
            raise ValueError(f"parameter {name}: expected {type(default).__name__}, got {value!r}")
        for limits in (*descriptor.floating_point_range, *descriptor.integer_range):
            if not limits.from_value <= value <= limits.to_value:
                raise ValueError(f"parameter {name}: expected {limits.from_value} to {limits.to_value}, got {value}")
        self._known[name] = value
        return SimpleNamespace(value=value)

    def get_parameters_by_prefix(self, prefix: str):
        return self._known

    def create_publisher(self, kind, topic, qos, *, event_callbacks=None) -> Publisher:
        network = self.process.network
        made = Publisher(network, self.process, kind, self.resolve_topic_name(topic), qos, event_callbacks)
        self.process.publishers.append(made)
        network.add_publisher(made)
        return made

    def create_subscription(self, kind, topic, callback, qos, *, callback_group=None, raw=False) -> Subscription:
        network, polled = self.process.network, isinstance(callback_group, PolledCallbackGroup)
        name = self.resolve_topic_name(topic)
        made = Subscription(network, self.process, kind, name, callback, qos, raw, polled)
        self.process.subscriptions.append(made)
        network.add_subscription(made)
        return made

    def create_timer(self, period, callback, *, clock=None) -> Timer:
        is_steady = clock is not None and clock.clock_type == ClockType.STEADY_TIME
        made = Timer(self.process, period, callback, is_steady)
        self.process.timers.append(made)
        return made

    def create_service(self, kind, name, callback, *, callback_group=None) -> None:
        self.process.services[name.replace("~", self._name)] = kind, callback

    def count_subscribers(self, topic: str) -> int:
        return len(self.get_subscriptions_info_by_topic(topic))

    def get_publishers_info_by_topic(self, topic: str) -> list:
        return self._infos(self.process.network.publishers, topic)

    def get_subscriptions_info_by_topic(self, topic: str) -> list:
        return self._infos(self.process.network.subscriptions, topic)

    def _infos(self, entities, topic: str) -> list[SimpleNamespace]:
        """Of those of the topic that this process knows: of one that was killed before it began it never hears."""
        name = self.resolve_topic_name(topic)
        known = [e for e in entities if e.topic_name == name and e.process.killed_at > self.process.began]
        return [
            SimpleNamespace(node_name=e.process.spec.name, node_namespace="/", qos_profile=e.qos_profile) for e in known
        ]

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return [(name, "/") for name in self.process.neighbours()]

    def destroy_node(self) -> None:
        """Nothing is open: the process forgets it."""


class Process:
    """One node of a graph, from its start to its end; started anew it is another Process.

    spec: as the graph's table has it; node_class: the class to run. `died` says of what it ended by itself.
    """

    def __init__(
        self, network: Network, spec: NodeSpec, node_class: type[Node], log: Callable[[str], None], neighbours
    ):
        self.network, self.scheduler, self.spec, self.log, self.neighbours = (
            network,
            network.scheduler,
            spec,
            log,
            neighbours,
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
        except (ValueError, OSError) as error:  # as np_ros.node.run: one line, and the end
            self._end(f"cannot start: {error}")
        self._is_running = False
        self.wake()

    def wake(self, when: int | None = None) -> None:
        """Run what is ready at `when` ns, or now."""
        when = max(self.scheduler.now, self._free_at, when or 0)
        if self._wake_at is None or when < self._wake_at or self._wake_at < self.scheduler.now:
            self._wake_at = when
            self.scheduler.at(when, lambda: self._run(when))

    def call_soon(self, action: Callable[[], None]) -> None:
        """Run `action` in the node's thread."""
        self._soon.append(action)
        self.wake()

    def occupy(self, ns: int) -> None:
        """The callback that runs takes so long: nothing else runs before."""
        self._free_at = max(self._free_at, self.scheduler.now + ns)

    def freeze(self) -> None:
        """Stop it as SIGSTOP does."""
        self.is_frozen = True

    def thaw(self) -> None:
        """Let it go on."""
        self.is_frozen = False
        for subscription in self.subscriptions:
            for link in subscription.links:
                link.thaw()
        self.wake()

    def kill(self) -> None:
        """End it as SIGKILL does: the others notice when its lease is over."""
        if self.is_alive:
            self.is_alive, self.killed_at = False, self.scheduler.now
            self.scheduler.after(LEASE * _MS, lambda: self.network.forget(self))

    def stop(self) -> None:
        """End it as SIGINT does: after the callback that runs, and no other runs after it."""
        if self.is_alive and self._is_running:
            self.scheduler.after(_MS, self.stop)
        elif self.is_alive:
            self._is_running = True
            self.node.destroy_node()
            self._end("")

    def call(self, service: str, request, answer: Callable[[object], None]) -> None:
        """Ask one of its services; `answer` is given the response, and nothing where the process dies before."""
        kind, callback = self.services[service]

        def serve() -> None:
            response = callback(request, kind.Response())
            self.scheduler.after(self.network.delay("", None), lambda: answer(response))

        self.scheduler.after(self.network.delay("", None), lambda: self.call_soon(serve))

    def _end(self, why: str) -> None:
        self.is_alive, self.died = False, why
        self.network.forget(self)
        if why:
            self.log(f"{self.spec.name}: ended: {why}")

    def _run(self, when: int) -> None:
        """One turn of np_ros.low_latency.spin: timers, one message of each subscription in the order they were made, services."""
        if when != self._wake_at:
            return  # woken earlier meanwhile
        self._wake_at = None
        if not self.is_alive or self._is_running or self.is_frozen:
            return
        if self.scheduler.now < self._free_at:
            return self.wake()
        self._is_running = True
        try:
            self._turn()
        except SystemExit:
            self._end("status 1")
        except Exception as error:  # noqa: BLE001  whatever a callback raises ends its process
            where = inspect.trace()[-1]
            self._end(f"crash: {type(error).__name__}: {error} ({where.filename.rsplit('/', 1)[-1]}:{where.lineno})")
        self._is_running = False
        if self.is_alive:
            self._sleep()

    def _turn(self) -> None:
        now = self.scheduler.now
        for timer in [each for each in self.timers if each.due is not None and each.due <= now]:
            if timer.due is not None and timer.due <= now:
                timer.call()
        for subscription in [each for each in self.subscriptions if each.waiting and not each.is_polled]:
            subscription.run()
        soon, self._soon = self._soon, []
        for action in soon:
            action()

    def _sleep(self) -> None:
        if self._soon or any(each.waiting and not each.is_polled for each in self.subscriptions):
            return self.wake()
        if dues := [due for timer in self.timers if (due := timer.due) is not None]:
            self.wake(min(dues))


def node_class(spec: NodeSpec) -> type[Node]:
    """The class of a node of the graph."""
    module = importlib.import_module(f"{spec.package}.nodes.{spec.executable}_node")
    return next(
        each
        for each in vars(module).values()
        if inspect.isclass(each) and issubclass(each, Node) and each.__module__ == module.__name__
    )
