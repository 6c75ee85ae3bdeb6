"""`ros2 node list` and `ros2 param list|get|set`."""

from __future__ import annotations

import sys

import yaml
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

from ros2_lite import graph
from ros2_lite.service import request

_FIELDS = {
    bool: ("bool_value", ParameterType.PARAMETER_BOOL),
    int: ("integer_value", ParameterType.PARAMETER_INTEGER),
    float: ("double_value", ParameterType.PARAMETER_DOUBLE),
    str: ("string_value", ParameterType.PARAMETER_STRING),
}


def list_nodes() -> int:
    """Print the full names of the nodes."""
    with graph.node() as node:
        for name in graph.discover(node, lambda: _full_names(node)):
            print(name)
    return 0


def list_parameters(target: str) -> int:
    """Print the parameters of a node."""
    with graph.node() as node:
        _check(node, target)
        found = request(node, ListParameters, f"{target}/list_parameters", ListParameters.Request())
        print("\n".join(sorted(found.result.names)))
    return 0


def get_parameter(target: str, name: str) -> int:
    """Print the value of a parameter."""
    with graph.node() as node:
        _check(node, target)
        found = request(node, GetParameters, f"{target}/get_parameters", GetParameters.Request(names=[name]))
        if not found.values or found.values[0].type == ParameterType.PARAMETER_NOT_SET:
            raise ValueError(f"{target}: expected one of its parameters, got {name!r}")
        print(parameter_value_to_python(found.values[0]))
    return 0


def set_parameter(target: str, name: str, text: str) -> int:
    """Set a parameter from YAML; 1 with the node's reason where it refuses."""
    value = yaml.safe_load(text)
    if type(value) not in _FIELDS:
        raise ValueError(f"value: expected true, false, a number or a text, got {text!r}")
    field, kind = _FIELDS[type(value)]
    parameter = Parameter(name=name, value=ParameterValue(type=kind, **{field: value}))
    with graph.node() as node:
        _check(node, target)
        done = request(node, SetParameters, f"{target}/set_parameters", SetParameters.Request(parameters=[parameter]))
    if not done.results[0].successful:
        print(f"setting {name} failed: {done.results[0].reason}", file=sys.stderr)
        return 1
    print("set")
    return 0


def _full_names(node: Node) -> list[str]:
    """Names of the nodes of the graph, hidden ones apart."""
    found = node.get_node_names_and_namespaces()
    return sorted(f"{space.rstrip('/')}/{name}" for name, space in found if not name.startswith("_"))


def _check(node: Node, target: str) -> None:
    """Raises LookupError where no node has the name."""
    known = graph.discover(node, lambda: _full_names(node), until=lambda names: target in names)
    if target not in known:
        raise LookupError(f"node {target}: expected one of {', '.join(known) or 'none in this ROS_DOMAIN_ID'}")
