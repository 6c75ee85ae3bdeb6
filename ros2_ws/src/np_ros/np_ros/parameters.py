"""The parameters of a node as it declares them: for its `--help`, for the reference, and to refuse names that it has not declared."""

from __future__ import annotations

import inspect
import sys
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rclpy.node import Node

# What keeps a node from going on to what it needs besides: weights, a robot, a thread that draws.
_UNAVAILABLE = {
    "weights": "none",
    "effects": "none",
    "hostname": "",
    "source": "",
    "camera": False,
    "record_at_start": False,
}
_OF_RCLPY = ("use_sim_time", "start_type_description_service")
_TO_COME = "qos_overrides."  # declared by rclpy as topics are opened, where a node allows them
HELP = ("--help", "-h")


@dataclass(frozen=True)
class NodeParameter:
    """A declared parameter."""

    name: str
    """As on the command line."""
    default: object
    """Its value where none is set."""
    allowed: str
    """Allowed values as text; empty: any."""
    meaning: str
    """A sentence with the unit."""


@dataclass(frozen=True)
class _Value:
    """A parameter's value as a node reads it."""

    value: object
    """The default."""


class _Declaring(Node):
    """Stands below a node's class while its constructor runs: keeps what is declared, and starts nothing."""

    def __init__(self, name: str):
        self.called = name
        self.declared: dict[str, NodeParameter] = {}

    def declare_parameter(self, name, default, descriptor):
        """Keep the parameter; the default is what the constructor goes on with."""
        allowed = [f"{r.from_value:.4g} to {r.to_value:.4g}" for r in descriptor.floating_point_range]
        allowed += [f"{r.from_value} to {r.to_value}" for r in descriptor.integer_range]
        allowed += [descriptor.additional_constraints] if descriptor.additional_constraints else []
        self.declared[name] = NodeParameter(name, default, "; ".join(allowed), descriptor.description)
        return _Value(_UNAVAILABLE.get(name, default))

    def create_publisher(self, *_, **__):
        """No topic is opened."""

    create_subscription = create_service = create_timer = create_publisher


def list_parameters(kind: type[Node]) -> list[NodeParameter]:
    """The parameters that a node's constructor declares before it needs what is not here. Needs no ROS domain."""
    node = object.__new__(type("Offline", (kind, _Declaring), {}))
    try:
        node.__init__()
    except Exception:  # noqa: BLE001  a robot, weights or a camera is missing; `make docs` holds that nothing was missed
        pass
    return list(node.declared.values())


def help_text(make_node: Callable[[], Node]) -> str:
    """The `--help` text of a node: its purpose, and every parameter with type, default, range and meaning."""
    lines = [f"usage: {Path(sys.argv[0]).name} [--ros-args -p NAME:=VALUE ...]", ""]
    purpose = (sys.modules[make_node.__module__].__doc__ or "").split("\n\n")[0]
    lines += [*textwrap.wrap(" ".join(purpose.split()), 100), ""]
    parameters = list_parameters(make_node) if inspect.isclass(make_node) else []
    lines += ["parameters:" if parameters else "no parameters"]
    for p in parameters:
        default = f"'{p.default}'" if isinstance(p.default, str) else str(p.default)
        lines.append(f"  {p.name}: {type(p.default).__name__}, default {default}{', ' * bool(p.allowed)}{p.allowed}")
        lines += textwrap.wrap(p.meaning, 94, initial_indent="      ", subsequent_indent="      ")
    return "\n".join(lines)


def check_known(node: Node) -> None:
    """Raises ValueError naming the parameters that a node was given and has not declared, and those that it has."""
    known = node.get_parameters_by_prefix("")
    unknown = [n for n in node._parameter_overrides if n not in known and not n.startswith(_TO_COME)]
    if unknown:
        own = ", ".join(sorted(set(known) - set(_OF_RCLPY))) or "none"
        raise ValueError(f"parameter {', '.join(unknown)}: not one of this node's, which are {own}")
