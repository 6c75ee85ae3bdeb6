"""Publishers and subscriptions of simulated processes, and the messages in transit between them, by their quality of service."""

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
    """A process that has publishers and subscriptions; np_evaluation.simtest.process implements it."""

    node: object
    is_alive: bool
    is_frozen: bool

    def wake(self) -> None:
        """Run the callbacks that are ready."""

    def call_soon(self, action: Callable[[], None]) -> None:
        """Run `action` in the node's thread."""


@dataclass
class TopicFault:
    """How the network changes the messages of a topic while a fault lasts."""

    delay: int = 0
    """Additional delay of every message, ns."""
    loss: float = 0.0
    """Share of the messages to best-effort subscriptions that is lost."""
    duplicates: float = 0.0
    """Share of the messages that are sent twice."""
    is_silent: bool = False
    """Whether all messages are dropped, as from a source that stopped publishing."""
    change: Callable[[bytes], bytes] | None = None
    """Maps the bytes of a message to those that are sent."""
    is_invalid: bool = False
    """Whether a subscriber must refuse and count the changed message."""


class Link:
    """Connects one publisher to one subscription. Reliable: all messages, in order. Best effort: in order, some lost."""

    def __init__(self, publisher: Publisher, subscription: Subscription):
        self.publisher, self.subscription = publisher, subscription
        self.is_reliable = _is_reliable(subscription.qos_profile)
        self.unacknowledged = 0
        self._pair = publisher.process, subscription.process
        self._last = 0
        self._held: deque = deque(maxlen=publisher.qos_profile.depth)  # messages to a frozen process

    def send(self, data: bytes, info: dict, delay: int) -> None:
        """Schedule the arrival of a message after `delay` ns."""
        network, scheduler = self.publisher.network, self.publisher.network.scheduler
        # Messages between two processes keep the order in which they were sent, except for the share that the run draws.
        in_order = scheduler.rng.random() >= network.reordered
        latest = network.arrivals.get(self._pair, 0)
        self._last = max(self._last, scheduler.now + delay, latest if in_order else 0)
        network.arrivals[self._pair] = max(self._last, latest)
        self.unacknowledged += self.is_reliable
        scheduler.call_at(self._last, lambda: self._arrive((data, info)))

    def _arrive(self, item: tuple[bytes, dict]) -> None:
        process = self.subscription.process
        if not process.is_alive:
            return  # not acknowledged
        if process.is_frozen:
            self._held.append(item)
            return
        self.unacknowledged -= self.is_reliable
        self.subscription.receive(*item)

    def thaw(self) -> None:
        """Deliver the messages held while the process was frozen."""
        self.unacknowledged = 0 if not self._held else self.unacknowledged
        while self._held:
            self._arrive(self._held.popleft())
        self.unacknowledged = 0


class Publisher:
    """The part of rclpy's Publisher that nodes use."""

    def __init__(self, network, process: Endpoint, kind: type, topic: str, qos: QoSProfile, events):
        self.network, self.process, self.kind = network, process, kind
        self.topic_name, self.qos_profile = topic, qos
        self.matched = getattr(events, "matched", None)
        self.links: list[Link] = []
        self._latched: deque = deque(maxlen=qos.depth if _is_latched(qos) else 0)
        self._number = count(1)

    def publish(self, message) -> None:
        """Send a message, or serialized bytes."""
        if not self.process.is_alive:
            return
        topic_fault = self.network.topic_faults.get(self.topic_name)
        if not (self.links or self._latched.maxlen or self.network.has_tap(self.topic_name)):
            next(self._number)
            return
        data = message if isinstance(message, bytes) else serialize_message(message)
        if topic_fault and topic_fault.is_silent:
            return
        if topic_fault and topic_fault.change:
            data = topic_fault.change(data)
        self.network.notify_taps(self, data)
        invalid = {"is_invalid": True} if topic_fault and topic_fault.is_invalid else {}
        rng = self.network.scheduler.rng
        for _ in range(1 + bool(topic_fault and rng.random() < topic_fault.duplicates)):
            info = {
                "source_timestamp": self.network.scheduler.wall,
                "received_timestamp": self.network.scheduler.wall,
                "publication_sequence_number": next(self._number),
                "reception_sequence_number": 0,
                **invalid,
            }
            self._latched.append((data, info))
            for link in self.links:
                if topic_fault and not link.is_reliable and rng.random() < topic_fault.loss:
                    continue
                link.send(data, info, self.network.draw_delay(self.topic_name, topic_fault))

    def connect(self, subscription: Subscription) -> None:
        """Match with a subscription; a latched one receives the kept messages."""
        if not (self.process.is_alive and subscription.process.is_alive):
            return
        link = Link(self, subscription)
        self.links.append(link)
        subscription.links.append(link)
        if _is_latched(subscription.qos_profile):
            for data, info in self._latched:
                link.send(data, info, self.network.draw_delay(self.topic_name, None))
        if self.matched:
            self.process.call_soon(lambda: self.matched(SimpleNamespace(current_count=len(self.links))))

    def get_subscription_count(self) -> int:
        """How many subscriptions have matched."""
        return len(self.links)

    def wait_for_all_acked(self, timeout) -> bool:
        """Whether all messages sent have arrived; it does not wait, since nodes call this only before they end."""
        return all(link.unacknowledged == 0 for link in self.links)


class Subscription:
    """The part of rclpy's Subscription that nodes use; a polling reader takes messages from `handle`."""

    def __init__(self, network, process, kind: type, topic: str, callback, qos: QoSProfile, raw: bool, is_polled: bool):
        self.network, self.process, self.msg_type, self.topic_name = network, process, kind, topic
        self.callback, self.qos_profile, self.raw, self.is_polled = callback, qos, raw, is_polled
        self.handle, self.links = self, []
        self.waiting: deque = deque(maxlen=qos.depth)
        self._with_info = not _takes_one(callback)

    def __enter__(self) -> Subscription:
        return self

    def __exit__(self, *_) -> None:
        """Release nothing."""

    def receive(self, data: bytes, info: dict) -> None:
        """Queue a message that has arrived; a full queue drops its oldest."""
        self.waiting.append((data, info))
        if not self.is_polled:
            self.process.wake()

    def take_message(self, kind: type, raw: bool):
        """Take the oldest queued message and its information, None if there is none; drop unreadable ones, as rclpy does."""
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
        """Call the callback with the oldest message."""
        if (taken := self.take_message(self.msg_type, self.raw)) is None:
            return
        counted = self.network.count_refusals(self) if (is_invalid := "is_invalid" in taken[1]) else 0
        self.callback(*taken) if self._with_info else self.callback(taken[0])
        if is_invalid and self.network.count_refusals(self) <= counted:
            self.network.on_accepted_invalid(self)

    def get_publisher_count(self) -> int:
        """How many publishers have matched."""
        return len(self.links)


def _is_reliable(qos: QoSProfile) -> bool:
    return qos.reliability == QoSReliabilityPolicy.RELIABLE


def _is_latched(qos: QoSProfile) -> bool:
    return qos.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL


def _takes_one(callback: Callable) -> bool:
    """Whether a callback takes the message alone, by rclpy's rule."""
    try:
        inspect.signature(callback).bind(object())
    except TypeError:
        return False
    return True
