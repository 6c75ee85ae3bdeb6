"""The simulated network: who finds whom, how long messages take, who looks at them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from rclpy.qos import QoSCompatibility, qos_check_compatible

from np_evaluation.simtest.endpoints import Endpoint, Publisher, Subscription, Weather
from np_evaluation.simtest.scheduler import Scheduler
from np_ros.node import Diagnostics

LEASE = 20_000  # ms after which the others notice that a process was killed (Fast DDS's default)


@dataclass
class Network:
    """All topics. `taps`: called with publisher and bytes of everything that is published, by topic ("" for all)."""

    scheduler: Scheduler
    publishers: list[Publisher] = field(default_factory=list)
    subscriptions: list[Subscription] = field(default_factory=list)
    weather: dict[str, Weather] = field(default_factory=dict)
    taps: dict[str, list[Callable[[Publisher, bytes], None]]] = field(default_factory=dict)
    slowest: float = 0.5
    """ms that a message takes at most where nothing is wrong."""
    reordered: float = 0.0
    """Share of the messages that may overtake those of other topics."""
    arrivals: dict[tuple[Endpoint, Endpoint], int] = field(default_factory=dict)
    """ns at which the last message from one process to another arrives."""

    def __post_init__(self) -> None:
        self.on_unrefused: Callable[[Subscription], None] = lambda subscription: None

    @staticmethod
    def count_refusals(subscription: Subscription) -> int:
        """How many messages the subscription's node has refused so far, by its diagnostics."""
        counts = diagnostics_of(subscription.process.node).counts
        return sum(count for key, count in counts.items() if key.startswith(("refused", "malformed")))

    def has_tap(self, topic: str) -> bool:
        """Whether somebody looks at what is published on a topic."""
        return topic in self.taps or "" in self.taps

    def tell(self, publisher: Publisher, data: bytes) -> None:
        """Show a message to those who look."""
        for topic in (publisher.topic_name, ""):
            for tap in self.taps.get(topic, ()):
                tap(publisher, data)

    def delay(self, topic: str, weather: Weather | None) -> int:
        """ns that the next message takes."""
        late = self.scheduler.rng.random() < 0.001  # a scheduler that gave the processor to somebody else
        usual = self.scheduler.draw(1.0, 10.0) if late else int(1e6 * self.scheduler.rng.uniform(0.03, self.slowest))
        return usual + (weather.delay if weather else 0)

    def add_publisher(self, publisher: Publisher) -> None:
        """A new publisher, which others find a little later."""
        self.publishers.append(publisher)
        for subscription in self.subscriptions:
            self._introduce(publisher, subscription)

    def add_subscription(self, subscription: Subscription) -> None:
        """A new subscription, which others find a little later."""
        self.subscriptions.append(subscription)
        for publisher in self.publishers:
            self._introduce(publisher, subscription)

    def _introduce(self, publisher: Publisher, subscription: Subscription) -> None:
        if publisher.topic_name != subscription.topic_name:
            return
        if qos_check_compatible(publisher.qos_profile, subscription.qos_profile)[0] != QoSCompatibility.ERROR:
            self.scheduler.after(self.scheduler.draw(5.0, 300.0), lambda: publisher.connect(subscription))

    def forget(self, process: Endpoint) -> None:
        """A process is gone, and the others know it."""
        self.publishers = [each for each in self.publishers if each.process is not process]
        self.subscriptions = [each for each in self.subscriptions if each.process is not process]
        for publisher in self.publishers:
            publisher.links = [link for link in publisher.links if link.subscription.process is not process]
        for subscription in self.subscriptions:
            subscription.links = [link for link in subscription.links if link.publisher.process is not process]


def diagnostics_of(node) -> Diagnostics | None:
    """The diagnostics of a node of the graph."""
    return getattr(node, "diagnostics", None) or getattr(node, "_diagnostics", None)
