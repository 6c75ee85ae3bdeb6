"""The ROS domain of this shell, and who else is in it."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # commands that only ask for the domain's number do without
    from rclpy.node import Node

_HIGHEST = 232  # the ports of higher ones do not exist
_DISCOVERY = 0.5  # s in which a participant that is there is found: twenty times what it takes on an idle machine
_NAMING = 3.0  # s in which the name of a node whose publisher was found comes after it
_UNKNOWN = "_NODE_NAME_UNKNOWN_"  # until then
_POLL = 0.02  # s


def ros_domain_id() -> int:
    """ROS_DOMAIN_ID, 0 where it is not set. Raises ValueError for what is none."""
    said = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not said.isdecimal() or int(said) > _HIGHEST:
        raise ValueError(f"ROS_DOMAIN_ID: expected a whole number from 0 to {_HIGHEST}, got {said!r}")
    return int(said)


def refuse_second(node: Node, topic: str) -> None:
    """Return once it is known that `node` is alone in publishing a topic that can have one publisher only.

    Call it late in the constructor, since discovery goes on meanwhile, and before threads that have to be ended: it waits for half a
    second. Raises ValueError that names the other.
    """
    name = node.resolve_topic_name(topic)
    deadline = time.monotonic() + _DISCOVERY
    while True:
        publishers = [info for info in node.get_publishers_info_by_topic(name) if info.node_name]
        if len(publishers) > 1:
            own = (node.get_name(), node.get_namespace())
            others = [p for p in publishers if (p.node_name, p.node_namespace) != own] or publishers[1:]
            if any(p.node_name == _UNKNOWN for p in others) and time.monotonic() < deadline + _NAMING:
                time.sleep(_POLL)
                continue
            names = {
                "a node" if p.node_name == _UNKNOWN else f"{p.node_namespace.rstrip('/')}/{p.node_name}" for p in others
            }
            found = ", ".join(sorted(names))
            raise ValueError(
                f"expected nobody else to publish {name} in ROS domain {ros_domain_id()}, found {found}: "
                "end the other graph, or set another ROS_DOMAIN_ID"
            )
        if time.monotonic() > deadline:
            return
        time.sleep(_POLL)


def twins(node: Node) -> int:
    """How many other nodes of this name are known in the domain."""
    own = (node.get_name(), node.get_namespace())
    return node.get_node_names_and_namespaces().count(own) - 1
