"""The ROS domain of this shell, and who else is in it."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from np_ros.processes.locks import lock

if TYPE_CHECKING:  # commands that only read the domain's number do without
    from rclpy.node import Node

_HIGHEST = 232  # the ports of higher ones do not exist
_DISCOVERY = 0.5  # s in which a participant that is there is found: twenty times what it takes on an idle machine
_NAMING = 3.0  # s in which the name of a node whose publisher was found comes after it
_UNKNOWN = "_NODE_NAME_UNKNOWN_"  # until then
_POLL = 0.02  # s


def ros_domain_id() -> int:
    """ROS_DOMAIN_ID, 0 where it is not set. Raises ValueError for what is none."""
    value = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not value.isdecimal() or int(value) > _HIGHEST:
        raise ValueError(f"ROS_DOMAIN_ID: expected a whole number from 0 to {_HIGHEST}, got {value!r}")
    return int(value)


class OnlyPublisher:
    """The right of `node` to be the only publisher of a topic in its ROS domain, held until `release`.

    Make it late in the constructor, since discovery goes on meanwhile, and before threads that have to be ended: it waits for half a
    second. Raises ValueError that names the other. Of two that start at once on this machine one has the right.
    """

    def __init__(self, node: Node, topic: str):
        self._node, self._topic = node, node.resolve_topic_name(topic)
        place = f"np_ros_domain_{ros_domain_id()}{self._topic.replace('/', '_')}.lock"
        self._place = Path(tempfile.gettempdir()) / place
        self._lock = None
        try:
            self._await()
        except ValueError:
            self.release()
            raise

    def release(self) -> None:
        """Let others have it."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _is_first(self) -> bool:
        """Whether no other process of this machine has the right, as one that is ending may still have."""
        if self._lock is None:
            try:
                self._lock = lock(self._place)
            except OSError:  # not ours to open: only discovery can show the other
                return True
        return self._lock is not None

    def _await(self) -> None:
        """Return once no other node publishes: one that started at the same time, and was not first, ends meanwhile."""
        begun = time.monotonic()
        while True:
            is_first = self._is_first()
            others, waited = self._others(), time.monotonic() - begun
            if is_first and not others and waited > _DISCOVERY:
                return
            is_known = not is_first and others and _UNKNOWN not in others
            if is_known or waited > _DISCOVERY + _NAMING:
                names = {"a node" if name == _UNKNOWN else name for name in others} or {
                    "another process of this machine"
                }
                raise ValueError(
                    f"expected nobody else to publish {self._topic} in ROS domain {ros_domain_id()}, "
                    f"found {', '.join(sorted(names))}: end the other graph, or set another ROS_DOMAIN_ID"
                )
            time.sleep(_POLL)

    def _others(self) -> set[str]:
        """The other publishers known by now, including one with the node's own name."""
        publishers = [info for info in self._node.get_publishers_info_by_topic(self._topic) if info.node_name]
        if len(publishers) <= 1:
            return set()
        own = (self._node.get_name(), self._node.get_namespace())
        others = [p for p in publishers if (p.node_name, p.node_namespace) != own] or publishers[1:]
        return {
            _UNKNOWN if p.node_name == _UNKNOWN else f"{p.node_namespace.rstrip('/')}/{p.node_name}" for p in others
        }


def count_namesakes(node: Node) -> int:
    """Number of other nodes of this name known in the domain."""
    own = (node.get_name(), node.get_namespace())
    return node.get_node_names_and_namespaces().count(own) - 1
