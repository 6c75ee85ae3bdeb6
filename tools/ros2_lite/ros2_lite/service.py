"""`ros2 service list|call`."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable

from rclpy.node import Node

from ros2_lite import graph
from ros2_lite.messages import fill_from_yaml, interface


def list_services(show_types: bool) -> int:
    """Print the services of the graph."""
    with graph.node() as node:
        graph.print_names(graph.discover(node, node.get_service_names_and_types), show_types)
    return 0


def request(node: Node, kind: type, name: str, content: object) -> object:
    """The response of a service, once it is there; prints on stderr what it waits for."""
    from np_ros.client.services import Services

    def wait(condition: Callable[[], object], timeout: float, what: str) -> None:
        if not condition():
            print(f"waiting for {what}", file=sys.stderr)
        while not condition():
            graph.spin_once(node, 0.1)

    return Services(node, wait).call(kind, name, content, math.inf)


def call(name: str, type_name: str, values: str) -> int:
    """Call a service with the fields that the YAML `values` gives; prints request and response."""
    kind = interface("srv", type_name)
    content = fill_from_yaml(kind.Request, values)
    with graph.node() as node:
        print(f"requester: making request: {content}\n", flush=True)
        print(f"response:\n{request(node, kind, name, content)}\n")
    return 0
