"""The parameters of a node's task: domain and object."""

from __future__ import annotations

from rclpy.node import Node

from np_description.domains import DOMAINS, Task
from np_description.objects.choice import DEFAULT, domain_with
from np_ros.node import parameter


def declare_domain(node: Node) -> Task:
    """Declare and read the parameters `domain` and `object`. Raises ValueError for an object that is none of the domain's."""
    domain = parameter(node, "domain", "card", "Task family.", choices=tuple(DOMAINS))
    object_ref = parameter(
        node,
        "object",
        DEFAULT,
        "What is moved: default, another row of the domain's table of objects, or a .yaml file of your own.",
    )
    return domain_with(domain, object_ref)
