"""A reader without a callback: the newest message of a stream, taken when it is needed.

A node that decides ten times a second needs ten of 500 states. Woken for each of them it spends most of its time on what it
throws away; here messages wait in the middleware, which keeps one, and the node is not woken.
"""

from __future__ import annotations

from rclpy.callback_groups import CallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node

from np_ros import qos


class PolledCallbackGroup(CallbackGroup):
    """A group whose members are never ready: neither rclpy's executor nor `np_ros.low_latency.spin` waits for them."""

    def can_execute(self, entity: object) -> bool:
        """Never."""
        return False

    def beginning_execution(self, entity: object) -> bool:
        """Never."""
        return False

    def ending_execution(self, entity: object) -> None:
        """Nothing has begun."""


class LatestMessage:
    """The newest message of a topic in real time, as bytes."""

    def __init__(self, node: Node, kind: type, topic: str) -> None:
        self._subscription = node.create_subscription(
            kind, topic, lambda data: None, qos.REALTIME_SUBSCRIBER, callback_group=PolledCallbackGroup(), raw=True
        )

    def take(self) -> bytes | None:
        """The message since the last call; None where none has come."""
        handle = self._subscription.handle
        try:
            with handle:
                taken = handle.take_message(self._subscription.msg_type, True)
        except InvalidHandle:  # the node is being destroyed
            return None
        return None if taken is None else taken[0]
