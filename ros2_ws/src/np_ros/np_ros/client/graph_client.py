"""A client node of a graph: publishes, collects, calls services, waits; for commands and for tests."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable

import rclpy
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

from np_ros import qos as profiles
from np_ros.client.interrupts import defer_interrupts
from np_ros.client.services import Services
from np_ros.low_latency.spin import Spinner


class GraphClient:
    """A node of this process in a ROS domain, that of ROS_DOMAIN_ID unless given; `limit` s is how long it waits.

    `messages[topic]` holds what was received, oldest first. End it with `close`.
    """

    def __init__(self, name: str, *, domain_id: int | None = None, limit: float = 20.0):
        self._limit = limit
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(name, context=self._context)
        self._spinner = Spinner(self.node)  # a client that replies to 500 states a second must not be the slowest part
        self._publishers: dict[str, object] = {}
        self._services = Services(self.node, self.wait_until)
        self.messages: dict[str, list] = defaultdict(list)

    def close(self) -> None:
        """Leave the graph."""
        self._spinner.close()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    def collect(
        self, topic: str, message_type: type, qos: QoSProfile = profiles.LOCKSTEP, callback: Callable | None = None
    ) -> list:
        """Keep what comes on `topic` in `messages[topic]` (the list returned), and hand it to `callback`."""
        received = self.messages[topic]

        def keep(message):
            received.append(message)
            if callback is not None:
                callback(message)

        self.node.create_subscription(message_type, topic, keep, qos)
        return received

    def advertise(self, topic: str, message_type: type, qos: QoSProfile = profiles.LOCKSTEP):
        """The publisher on `topic`, made at the first call. Wait for `matched` before the first message."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(message_type, topic, qos)
        return self._publishers[topic]

    def publish(self, topic: str, message, qos: QoSProfile = profiles.LOCKSTEP) -> None:
        """Publish `message` on `topic`."""
        self.advertise(topic, type(message), qos).publish(message)

    def matched(self, topic: str, subscribers: int = 1) -> bool:
        """Whether our publisher on `topic` has that many subscribers."""
        return self._publishers[topic].get_subscription_count() >= subscribers

    def publishers(self, topic: str) -> list[str]:
        """Names of the nodes that publish `topic`."""
        return [info.node_name for info in self.node.get_publishers_info_by_topic(_resolve(topic))]

    def subscribers(self, topic: str) -> list[str]:
        """Names of the nodes that subscribe to `topic`."""
        return [info.node_name for info in self.node.get_subscriptions_info_by_topic(_resolve(topic))]

    def spin_once(self, timeout: float = 0.05) -> None:
        """Wait up to `timeout` s and run the callbacks that are ready."""
        with defer_interrupts():
            self._spinner.spin_once(timeout)

    def wait_until(
        self, condition: Callable[[], object], timeout: float | None = None, what: str = "the condition"
    ) -> None:
        """Spin until `condition()` holds. Raises TimeoutError that names `what`."""
        limit = self._limit if timeout is None else timeout
        deadline = time.monotonic() + limit
        while not condition():
            if time.monotonic() > deadline:
                raise TimeoutError(f"expected {what} within {limit:g} s; it did not come")
            self.spin_once()

    def call(self, service: str, request: bool | None = None, timeout: float | None = None):
        """The response of a std_srvs service: Trigger, or SetBool where `request` is a bool."""
        kind = SetBool if isinstance(request, bool) else Trigger
        content = kind.Request(data=request) if isinstance(request, bool) else kind.Request()
        return self._services.call(kind, service, content, self._limit if timeout is None else timeout)

    def idle_for(self, seconds: float) -> None:
        """Spin for `seconds`, to see that something does NOT come."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            self.spin_once(min(left, 0.05))


def _resolve(topic: str) -> str:
    return topic if topic.startswith("/") else f"/{topic}"
