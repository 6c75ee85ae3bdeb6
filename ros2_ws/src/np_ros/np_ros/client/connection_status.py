"""Whether every publisher of a graph has found its subscribers, by the diagnostics of the nodes."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible

from np_ros import qos
from np_ros.node import SUBSCRIBERS


def has_all_subscribers(node: Node, topic: str, found: int) -> bool:
    """Whether the subscribers that a publisher of `topic` has found, so many, are all that match it, in the graph that `node` sees.

    One that requests more than is offered (a latched topic, of one that is not) is never matched and receives nothing.
    """
    if found >= node.count_subscribers(topic):
        return True
    offered = [publisher.qos_profile for publisher in node.get_publishers_info_by_topic(topic)]
    asked = [subscriber.qos_profile for subscriber in node.get_subscriptions_info_by_topic(topic)]
    deaf = (all(qos_check_compatible(o, a)[0] == QoSCompatibility.ERROR for o in offered) for a in asked)
    return bool(offered) and found >= len(asked) - sum(deaf)


class ConnectionStatus:
    """Listens to `diagnostics` with `node` and compares counts of subscribers with what `node` sees of the
    graph.

    A node sees its own matches only, and one that two other nodes have not made yet loses what is published
    until then.
    """

    def __init__(self, node: Node):
        self._node = node
        self._found: dict[str, dict[str, int]] = {}  # node, topic: how many subscribers the node reports
        node.create_subscription(DiagnosticArray, "diagnostics", self._receive, qos.RECORDER)

    def are_complete(self, names: set[str]) -> bool:
        """Whether the named nodes are up and every publisher, `node`'s too, has found every subscriber."""
        own = {p.topic_name: p.get_subscription_count() for p in self._node.publishers}
        return names <= set(self._found) and all(
            has_all_subscribers(self._node, topic, count)
            for counts in (own, *self._found.values())
            for topic, count in counts.items()
        )

    def missing(self, names: set[str]) -> list[str]:
        """The named nodes whose diagnostics have not come yet."""
        return sorted(names - set(self._found))

    def _receive(self, message: DiagnosticArray) -> None:
        for status in message.status:
            links = next((value.value for value in status.values if value.key == SUBSCRIBERS), "")
            self._found[status.name.lstrip("/")] = {
                topic: int(count) for topic, _, count in (link.rpartition("=") for link in links.split())
            }
