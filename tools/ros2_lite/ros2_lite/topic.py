"""`ros2 topic list|info|echo|hz|pub`."""

from __future__ import annotations

import statistics
import sys
import time
from collections import deque

import yaml
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy

from ros2_lite import graph
from ros2_lite.messages import fill_from_yaml, interface, plain

MAX_ITEMS = 128  # array entries printed without --full-length


def list_topics(show_types: bool) -> int:
    """Print the topics of the graph."""
    with graph.node() as node:
        graph.print_names(graph.discover(node, node.get_topic_names_and_types), show_types)
    return 0


def _wait_for_topic(node: Node, topic: str) -> tuple[str, type]:
    """Full name and message class of a topic, once it is published; prints on stderr that it waits."""
    name, is_announced = node.resolve_topic_name(topic), False
    while not node.count_publishers(name):
        if not is_announced:
            print(f"waiting for a publisher of {name}", file=sys.stderr)
            is_announced = True
        graph.spin_once(node, 0.1)
    types = dict(node.get_topic_names_and_types())[name]
    if len(types) != 1:
        raise ValueError(f"{name}: expected one message type, the graph has {types}")
    return name, interface("msg", types[0])


def _profile(node: Node, name: str) -> QoSProfile:
    """A profile that matches every publisher of the topic: reliable and latched only if all of them are."""
    profiles = [info.qos_profile for info in node.get_publishers_info_by_topic(name)]
    reliable = all(p.reliability == QoSReliabilityPolicy.RELIABLE for p in profiles)
    latched = all(p.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    return QoSProfile(
        depth=100,
        reliability=QoSReliabilityPolicy.RELIABLE if reliable else QoSReliabilityPolicy.BEST_EFFORT,
        durability=QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE,
    )


def echo(topic: str, once: bool, full_length: bool) -> int:
    """Print the messages of a topic as YAML documents."""
    with graph.node() as node:
        name, message_type = _wait_for_topic(node, topic)
        received = deque()
        node.create_subscription(message_type, name, lambda message: received.append(message), _profile(node, name))
        while True:
            graph.spin_once(node, 1.0)
            while received:
                document = plain(received.popleft(), None if full_length else MAX_ITEMS)
                text = yaml.safe_dump(document, sort_keys=False, default_flow_style=False)
                print(text, end="---\n", flush=True)
                if once:
                    return 0


def rate_line(arrivals: deque) -> str:
    """Rate and spread of arrival times (s) as `ros2 topic hz` words them."""
    times = list(arrivals)
    gaps = [after - before for before, after in zip(times, times[1:])]
    mean = statistics.fmean(gaps)
    return (
        f"average rate: {1 / mean:.3f}\n\tmin: {min(gaps):.4f}s max: {max(gaps):.4f}s "
        f"std dev: {statistics.pstdev(gaps, mean):.5f}s window: {len(times)}"
    )


def hz(topic: str, window: int) -> int:
    """Print the arrival rate of a topic once a second."""
    with graph.node() as node:
        name, message_type = _wait_for_topic(node, topic)
        arrivals = deque(maxlen=max(2, window))
        node.create_subscription(
            message_type, name, lambda _: arrivals.append(time.monotonic()), _profile(node, name), raw=True
        )
        printed = time.monotonic()
        while True:
            graph.spin_once(node, 0.1)
            if time.monotonic() - printed >= 1.0:
                printed = time.monotonic()
                print(rate_line(arrivals) if len(arrivals) > 1 else "no new messages", flush=True)


def info(topic: str, verbose: bool) -> int:
    """Print type, publishers and subscribers of a topic; verbose: their nodes and quality of service."""
    with graph.node() as node:
        name = node.resolve_topic_name(topic)

        def read() -> list:
            ends = [node.get_publishers_info_by_topic(name), node.get_subscriptions_info_by_topic(name)]
            return [sorted(map(_endpoint, one)) for one in ends]

        publishers, subscribers = graph.discover(node, read)
        types = dict(node.get_topic_names_and_types()).get(name)
    if not types:
        raise LookupError(f"topic {name}: expected a publisher or a subscriber, there is none")
    print(f"Type: {', '.join(types)}")
    for title, ends in (("Publisher", publishers), ("Subscription", subscribers)):
        print(f"{title} count: {len(ends)}")
        print("".join(f"  {' '.join(end)}\n" for end in ends) if verbose else "", end="")
    return 0


def _endpoint(info) -> tuple[str, ...]:
    profile = info.qos_profile
    return (
        f"{info.node_namespace.rstrip('/')}/{info.node_name}",
        profile.reliability.name.lower(),
        profile.durability.name.lower(),
    )


def pub(topic: str, type_name: str, values: str, once: bool, rate: float) -> int:
    """Publish a message `rate` times a second; once: as soon as somebody subscribes, and end.

    Reliable and latched, which every subscriber matches.
    """
    message = fill_from_yaml(interface("msg", type_name), values)
    profile = QoSProfile(
        depth=1, reliability=QoSReliabilityPolicy.RELIABLE, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL
    )
    with graph.node() as node:
        publisher = node.create_publisher(type(message), topic, profile)
        while once and not publisher.get_subscription_count():
            graph.spin_once(node, 0.1)
        while True:
            publisher.publish(message)
            print(f"publishing: {message}", flush=True)
            if once:
                publisher.wait_for_all_acked(Duration(seconds=2))
                return 0
            end = time.monotonic() + 1 / rate
            while (left := end - time.monotonic()) > 0:
                graph.spin_once(node, left)
