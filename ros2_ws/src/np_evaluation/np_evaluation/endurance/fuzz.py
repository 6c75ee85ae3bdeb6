"""Random and malformed messages on every topic of a graph: which nodes live on, and what they refused."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message, serialize_message

from np_evaluation.endurance.random_messages import break_bytes, break_message, message_type, random_message
from np_record.topics import TOPICS, Topic
from np_ros import qos
from np_ros.client.graph_client import GraphClient
from np_ros.processes.supervisor import NodeDied, Supervisor

BATCH = 20  # messages after which the processes are checked
HEARD = 2  # diagnostics of a node, after the last message, until its counts are valid
PATIENCE = 30.0  # s for them
DRAIN = 1.0  # s in which the last messages arrive


@dataclass
class FuzzResult:
    """The result of fuzzing one topic."""

    topic: str
    """Its name."""
    sent: dict[str, int] = field(default_factory=dict)
    """Number of messages by kind."""
    refused: dict[str, int] = field(default_factory=dict)
    """Number of refusals by node."""
    died: dict[str, str] = field(default_factory=dict)
    """Last lines of the nodes that died, by node."""
    silent: list[str] = field(default_factory=list)
    """Nodes that stopped publishing diagnostics."""


class Fuzzer:
    """Sends to a graph of `supervisor` with `peer`; restart(name) starts a node again that has died."""

    def __init__(self, peer: GraphClient, supervisor: Supervisor, restart: Callable[[str], None], seed: int):
        self._peer, self._supervisor, self._restart = peer, supervisor, restart
        self._rng = np.random.default_rng(seed)
        self._samples: dict[str, list[bytes]] = {}
        self._counts: dict[str, dict[str, int]] = {}
        self._heard: dict[str, int] = {}
        self._sends = self._hears_itself = False
        peer.collect("diagnostics", DiagnosticArray, qos.RECORDER, self._on_diagnostics)
        for topic in TOPICS:
            self._collect_samples(topic)

    @property
    def speaking(self) -> set[str]:
        """The nodes whose diagnostics have been received."""
        return set(self._heard)

    def has_samples(self, *topics: str) -> bool:
        """Whether there are real messages of these topics."""
        return all(self._samples[name] for name in topics)

    def fuzz(self, topic: Topic, count: int) -> FuzzResult | None:
        """Send `count` messages on a topic; None where no node subscribes to it."""
        nodes = sorted(set(self._peer.subscribers(topic.name)) & set(self._supervisor.names))
        if not nodes:
            return None
        kind = message_type(topic.type)
        publisher = self._peer.advertise(topic.name, kind, qos.LATCHED if topic.latched else qos.LOCKSTEP)
        self._peer.wait_until(lambda: publisher.get_subscription_count() >= len(nodes), PATIENCE, f"{topic.name}")
        found, self._sends = FuzzResult(topic.name), True
        self._wait_for_reports(nodes, found)
        before = {name: self._refusals(name) for name in nodes}
        self._hears_itself = (
            topic.name == "diagnostics"
        )  # a node's own diagnostics cannot be distinguished from those that we make up
        for number in range(count):
            way, message = self._make(topic, kind)
            found.sent[way] = found.sent.get(way, 0) + 1
            publisher.publish(message)
            if number % BATCH == BATCH - 1:
                self._peer.spin_once(0.01)
                self._restart_dead(found)
        self._peer.idle_for(DRAIN)
        self._hears_itself = False
        self._wait_for_reports(nodes, found)
        for name in nodes:
            if name not in found.died:
                found.refused[name] = self._refusals(name) - before[name]
        return found

    def _make(self, topic: Topic, kind: type) -> tuple[str, object]:
        samples = self._samples.get(topic.name)
        way = self._rng.choice(("random", "broken", "bytes"), p=(0.4, 0.4, 0.2))
        if way == "random" or (way == "broken" and not samples):
            return "random", random_message(kind, self._rng)
        if way == "broken":
            return way, break_message(deserialize_message(self._pick(samples), kind), self._rng)
        data = self._pick(samples) if samples else serialize_message(random_message(kind, self._rng))
        return way, break_bytes(data, self._rng)

    def _pick(self, samples: list[bytes]) -> bytes:
        return samples[int(self._rng.integers(len(samples)))]

    def _restart_dead(self, found: FuzzResult) -> None:
        """Note who has died, and start them again."""
        try:
            self._supervisor.check()
        except NodeDied as death:
            found.died[death.name] = str(death)
            self._counts.pop(death.name, None)
            self._restart(death.name)

    def _wait_for_reports(self, nodes: list[str], found: FuzzResult) -> None:
        """Wait until every node has published new diagnostics."""
        since = {name: self._heard.get(name, 0) for name in nodes}
        deadline = time.monotonic() + PATIENCE
        while waiting := [name for name in nodes if self._heard.get(name, 0) < since[name] + HEARD]:
            self._restart_dead(found)
            if time.monotonic() > deadline:
                found.silent += [name for name in waiting if name not in found.silent]
                return
            self._peer.spin_once()

    def _refusals(self, name: str) -> int:
        return sum(count for key, count in self._counts.get(name, {}).items() if key.startswith("refused"))

    def _collect_samples(self, topic: Topic) -> None:
        kept = self._samples.setdefault(topic.name, [])

        def keep(data: bytes) -> None:
            if len(kept) < 20 and not self._sends:  # else it would collect its own messages
                kept.append(bytes(data))

        profile = qos.LATCHED if topic.latched else qos.REALTIME_SUBSCRIBER
        self._peer.node.create_subscription(message_type(topic.type), topic.name, keep, profile, raw=True)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            name = status.name.lstrip("/")
            if self._hears_itself or name not in self._supervisor.names:
                continue  # what we have made up
            self._heard[name] = self._heard.get(name, 0) + 1
            self._counts[name] = {p.key: int(p.value) for p in status.values if p.value.isascii() and p.value.isdigit()}
