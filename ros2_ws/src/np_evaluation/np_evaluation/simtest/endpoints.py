"""Publishers and subscriptions of simulated processes, and what is on its way between them, by the rules of their quality of service."""

from __future__ import annotations

import inspect
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from types import SimpleNamespace
from typing import Protocol

from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message


class Endpoint(Protocol):
    """What has publishers and subscriptions: np_evaluation.simtest.node has the class."""

    node: object
    is_alive: bool
    is_frozen: bool

    def wake(self) -> None:
        """Run what is ready."""

    def call_soon(self, action: Callable[[], None]) -> None:
        """Run `action` in the node's thread."""


@dataclass
class Weather:
    """What the network does to a topic while a fault lasts."""

    delay: int = 0
    """ns that every message takes longer."""
    loss: float = 0.0
    """Share of the messages to best-effort readers that is lost."""
    duplicates: float = 0.0
    """Share of the messages that somebody sends a second time."""
    is_silent: bool = False
    """Whether what is published is thrown away, as by a source that has fallen silent."""
    change: Callable[[bytes], bytes] | None = None
    """What becomes of a message's bytes."""
    is_refusable: bool = False
    """Whether what it becomes must be refused, and counted, by who reads it."""


class Link:
    """From one publisher to one subscription. Reliable: all messages, in order. Best effort: in order, some lost."""

    def __init__(self, publisher: Publisher, subscription: Subscription):
        self.publisher, self.subscription = publisher, subscription
        self.is_reliable = _is_reliable(subscription.qos_profile)
        self.unacknowledged = 0
        self._pair = publisher.process, subscription.process
        self._last = 0
        self._held: deque = deque(maxlen=publisher.qos_profile.depth)  # for a process that is frozen

    def send(self, data: bytes, info: dict, delay: int) -> None:
        """Put a message on its way."""
        network, scheduler = self.publisher.network, self.publisher.network.scheduler
        # What one process sends another comes in the order of its sending, but for the share that a run draws.
        in_order = scheduler.rng.random() >= network.reordered
        latest = network.arrivals.get(self._pair, 0)
        self._last = max(self._last, scheduler.now + delay, latest if in_order else 0)
        network.arrivals[self._pair] = max(self._last, latest)
        self.unacknowledged += self.is_reliable
        scheduler.at(self._last, lambda: self._arrive((data, info)))

    def _arrive(self, item: tuple[bytes, dict]) -> None:
        process = self.subscription.process
        if not process.is_alive:
            return  # nobody says that it came
        if process.is_frozen:
            self._held.append(item)
            return
        self.unacknowledged -= self.is_reliable
        self.subscription.take_in(*item)

    def thaw(self) -> None:
        """What waited for a frozen process arrives."""
        self.unacknowledged = 0 if not self._held else self.unacknowledged
        while self._held:
            self._arrive(self._held.popleft())
        self.unacknowledged = 0


class Publisher:
    """As rclpy's, as far as nodes use it."""

    def __init__(self, network, process: Endpoint, kind: type, topic: str, qos: QoSProfile, events):
        self.network, self.process, self.kind = network, process, kind
        self.topic_name, self.qos_profile = topic, qos
        self.matched = getattr(events, "matched", None)
        self.links: list[Link] = []
        self._latched: deque = deque(maxlen=qos.depth if _is_latched(qos) else 0)
        self._number = count(1)

    def publish(self, message) -> None:
        """Send a message, or its bytes."""
        if not self.process.is_alive:
            return
        weather = self.network.weather.get(self.topic_name)
        if not (self.links or self._latched.maxlen or self.network.has_tap(self.topic_name)):
            next(self._number)
            return
        data = message if isinstance(message, bytes) else serialize_message(message)
        if weather and weather.is_silent:
            return
        if weather and weather.change:
            data = weather.change(data)
        self.network.tell(self, data)
        broken = {"is_broken": True} if weather and weather.is_refusable else {}
        rng = self.network.scheduler.rng
        for _ in range(1 + bool(weather and rng.random() < weather.duplicates)):
            info = {
                "source_timestamp": self.network.scheduler.wall,
                "received_timestamp": self.network.scheduler.wall,
                "publication_sequence_number": next(self._number),
                "reception_sequence_number": 0,
                **broken,
            }
            self._latched.append((data, info))
            for link in self.links:
                if weather and not link.is_reliable and rng.random() < weather.loss:
                    continue
                link.send(data, info, self.network.delay(self.topic_name, weather))

    def connect(self, subscription: Subscription) -> None:
        """The two have found each other."""
        if not (self.process.is_alive and subscription.process.is_alive):
            return
        link = Link(self, subscription)
        self.links.append(link)
        subscription.links.append(link)
        if _is_latched(subscription.qos_profile):
            for data, info in self._latched:
                link.send(data, info, self.network.delay(self.topic_name, None))
        if self.matched:
            self.process.call_soon(lambda: self.matched(SimpleNamespace(current_count=len(self.links))))

    def get_subscription_count(self) -> int:
        """How many subscriptions it has found."""
        return len(self.links)

    def wait_for_all_acked(self, timeout) -> bool:
        """Whether all that was sent has arrived. Nobody is waited for: who asks does so before it ends."""
        return all(link.unacknowledged == 0 for link in self.links)


class Subscription:
    """As rclpy's, as far as nodes use it; `handle` is what a reader without callbacks takes from."""

    def __init__(self, network, process, kind: type, topic: str, callback, qos: QoSProfile, raw: bool, is_polled: bool):
        self.network, self.process, self.msg_type, self.topic_name = network, process, kind, topic
        self.callback, self.qos_profile, self.raw, self.is_polled = callback, qos, raw, is_polled
        self.handle, self.links = self, []
        self.waiting: deque = deque(maxlen=qos.depth)
        self._with_info = not _takes_one(callback)

    def __enter__(self) -> Subscription:
        return self

    def __exit__(self, *_) -> None:
        """Nothing is held."""

    def take_in(self, data: bytes, info: dict) -> None:
        """A message has arrived; of more than the depth the oldest is dropped."""
        self.waiting.append((data, info))
        if not self.is_polled:
            self.process.wake()

    def take_message(self, kind: type, raw: bool):
        """The oldest message that waits and its information, or None; one that cannot be read is dropped, as in rclpy."""
        while self.waiting:
            data, info = self.waiting.popleft()
            if raw:
                return data, info
            try:
                return deserialize_message(data, kind), info
            except RuntimeError:
                continue
        return None

    def run(self) -> None:
        """Hand the oldest message to the callback."""
        if (taken := self.take_message(self.msg_type, self.raw)) is None:
            return
        counted = self.network.count_refusals(self) if (is_broken := "is_broken" in taken[1]) else 0
        self.callback(*taken) if self._with_info else self.callback(taken[0])
        if is_broken and self.network.count_refusals(self) <= counted:
            self.network.on_unrefused(self)

    def get_publisher_count(self) -> int:
        """How many publishers it has found."""
        return len(self.links)


def _is_reliable(qos: QoSProfile) -> bool:
    return qos.reliability == QoSReliabilityPolicy.RELIABLE


def _is_latched(qos: QoSProfile) -> bool:
    return qos.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL


def _takes_one(callback: Callable) -> bool:
    """Whether a callback is given the message alone, decided as rclpy does."""
    try:
        inspect.signature(callback).bind(object())
    except TypeError:
        return False
    return True
