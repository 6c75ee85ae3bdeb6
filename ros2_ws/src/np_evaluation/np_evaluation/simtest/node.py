"""Replaces rclpy's Node as the base of the graph's node classes, on the simulated network."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

from builtin_interfaces.msg import Time
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter

from np_description.control_rate import SECOND
from np_evaluation.simtest.endpoints import Endpoint, Publisher, Subscription
from np_ros.low_latency.latest_message import PolledCallbackGroup


class Timer:
    """The part of rclpy's Timer that nodes use. Unless it is steady it follows the wall clock, which may jump."""

    def __init__(self, process: Endpoint, period: float, callback: Callable[[], None], is_steady: bool):
        self._process, self.callback, self._is_steady = process, callback, is_steady
        self._period = round(period * SECOND)
        self._next: int | None = None
        self.reset()

    def reset(self) -> None:
        """Run again one period from now."""
        self._next = self._read_clock() + self._period
        self._process.wake(self.due)

    def cancel(self) -> None:
        """Stop until `reset`."""
        self._next = None

    def is_canceled(self) -> bool:
        """Whether it is stopped."""
        return self._next is None

    @property
    def due(self) -> int | None:
        """Time of the next run, ns of the steady clock; None if it is stopped."""
        if self._next is None or self._is_steady:
            return self._next
        return self._next - self._process.scheduler.wall_offset

    def call(self) -> None:
        """Run the callback; skip missed periods."""
        late = self._read_clock() - self._next
        self._next += self._period * (1 + late // self._period)
        self.callback()

    def _read_clock(self) -> int:
        return self._process.scheduler.now if self._is_steady else self._process.scheduler.wall


class SimulatedNode(Node):
    """Replaces rclpy's Node; `Process` sets `process` before the constructor runs."""

    process: Endpoint

    def __init__(self, name: str):
        self._name = name
        self._parameter_overrides = {
            key: Parameter(key, value=value) for key, value in self.process.spec.parameters.items()
        }
        self._declared: dict[str, object] = {}

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
        self._declared[name] = value
        return SimpleNamespace(value=value)

    def get_parameters_by_prefix(self, prefix: str):
        return self._declared

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
        return self._list_info(self.process.network.publishers, topic)

    def get_subscriptions_info_by_topic(self, topic: str) -> list:
        return self._list_info(self.process.network.subscriptions, topic)

    def _list_info(self, entities, topic: str) -> list[SimpleNamespace]:
        """List the discovered endpoints of a topic: a process never discovers one that was killed before its own start."""
        name = self.resolve_topic_name(topic)
        found = [e for e in entities if e.topic_name == name and e.process.killed_at > self.process.began]
        return [
            SimpleNamespace(node_name=e.process.spec.name, node_namespace="/", qos_profile=e.qos_profile) for e in found
        ]

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return [(name, "/") for name in self.process.node_names()]

    def destroy_node(self) -> None:
        """Close nothing: the process holds no resources."""
