"""The simulated network: discovery, delays of messages, and taps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from rclpy.qos import QoSCompatibility, qos_check_compatible

from np_evaluation.simtest.endpoints import Endpoint, Publisher, Subscription, TopicFault
from np_evaluation.simtest.scheduler import Scheduler
from np_ros.node import Diagnostics

LEASE = 20_000  # ms until the others detect that a process was killed (default of Fast DDS)


@dataclass
class Network:
    """All topics. `taps`: by topic ("" for all), functions called with the publisher and bytes of every published message."""

    scheduler: Scheduler
    publishers: list[Publisher] = field(default_factory=list)
    subscriptions: list[Subscription] = field(default_factory=list)
    topic_faults: dict[str, TopicFault] = field(default_factory=dict)
    taps: dict[str, list[Callable[[Publisher, bytes], None]]] = field(default_factory=dict)
    slowest: float = 0.5
    """Largest delay of a message without faults, ms."""
    reordered: float = 0.0
    """Share of the messages that may overtake those of other topics."""
    delayed: float = 0.001
    """Share of the messages that wait for the processor, for 1 to 10 ms."""
    arrivals: dict[tuple[Endpoint, Endpoint], int] = field(default_factory=dict)
    """ns at which the last message from one process to another arrives."""

    def __post_init__(self) -> None:
        self.on_accepted_invalid: Callable[[Subscription], None] = lambda subscription: None

    @staticmethod
    def count_refusals(subscription: Subscription) -> int:
        """Count the messages that the subscription's node has refused so far, from its diagnostics."""
        counts = find_diagnostics(subscription.process.node).counts
        return sum(count for key, count in counts.items() if key.startswith(("refused", "malformed")))

    def has_tap(self, topic: str) -> bool:
        """Whether a tap receives the messages of a topic."""
        return topic in self.taps or "" in self.taps

    def notify_taps(self, publisher: Publisher, data: bytes) -> None:
        """Call the taps of a message's topic."""
        for topic in (publisher.topic_name, ""):
            for tap in self.taps.get(topic, ()):
                tap(publisher, data)

    def draw_delay(self, topic: str, topic_fault: TopicFault | None) -> int:
        """Draw the delay of the next message, ns."""
        scheduler = self.scheduler
        is_late = scheduler.rng.random() < self.delayed  # preempted by the operating system
        usual = scheduler.draw_time(1.0, 10.0) if is_late else int(1e6 * scheduler.rng.uniform(0.03, self.slowest))
        return usual + (topic_fault.delay if topic_fault else 0)

    def add_publisher(self, publisher: Publisher) -> None:
        """Add a publisher; subscriptions match a little later."""
        self.publishers.append(publisher)
        for subscription in self.subscriptions:
            self._match(publisher, subscription)

    def add_subscription(self, subscription: Subscription) -> None:
        """Add a subscription; publishers match a little later."""
        self.subscriptions.append(subscription)
        for publisher in self.publishers:
            self._match(publisher, subscription)

    def _match(self, publisher: Publisher, subscription: Subscription) -> None:
        if publisher.topic_name != subscription.topic_name:
            return
        if qos_check_compatible(publisher.qos_profile, subscription.qos_profile)[0] != QoSCompatibility.ERROR:
            self.scheduler.call_after(self.scheduler.draw_time(5.0, 300.0), lambda: publisher.connect(subscription))

    def remove(self, process: Endpoint) -> None:
        """Remove a process's publishers, subscriptions and links."""
        self.publishers = [each for each in self.publishers if each.process is not process]
        self.subscriptions = [each for each in self.subscriptions if each.process is not process]
        for publisher in self.publishers:
            publisher.links = [link for link in publisher.links if link.subscription.process is not process]
        for subscription in self.subscriptions:
            subscription.links = [link for link in subscription.links if link.publisher.process is not process]


def find_diagnostics(node) -> Diagnostics | None:
    """Find the diagnostics of a node of the graph, None if it has none."""
    return getattr(node, "diagnostics", None) or getattr(node, "_diagnostics", None)
