"""docs/reference/parameters.md: what every node and every launch can be told, from what they declare."""

from __future__ import annotations

import ast
import importlib
import inspect
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rclpy.node import Node

from np_bringup.task_graph import ARGUMENTS
from pages.markdown import head, number, table

# What keeps a node from going on to what it needs besides: weights, a robot, a thread that draws.
UNAVAILABLE = {
    "weights": "none",
    "effects": "none",
    "hostname": "",
    "source": "",
    "camera": False,
    "record_at_start": False,
}
INTRODUCTION = """Written from the code. A parameter is set at the start (`--ros-args -p name:=value`) and read-only from
then on; a value of another type or out of range is refused by name. The meaning says the unit."""


@dataclass(frozen=True)
class Value:
    """What a node reads of a parameter."""

    value: object


@dataclass(frozen=True)
class Parameter:
    """A declared parameter: name, default, allowed values as text, meaning."""

    name: str
    default: object
    allowed: str
    meaning: str


class Declaring(Node):
    """Stands below a node's class while its constructor runs: keeps what is declared, and starts nothing."""

    def __init__(self, name: str):
        self.called = name
        self.declared: dict[str, Parameter] = {}

    def declare_parameter(self, name, default, descriptor):
        """Keep the parameter; the default is what the constructor goes on with."""
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        allowed = [f"{number(r.from_value)} to {number(r.to_value)}" for r in ranges]
        allowed += [descriptor.additional_constraints] if descriptor.additional_constraints else []
        self.declared[name] = Parameter(name, default, "; ".join(allowed), descriptor.description)
        return Value(UNAVAILABLE.get(name, default))

    def create_publisher(self, *_, **__):
        """No topic is opened."""

    create_subscription = create_service = create_timer = create_publisher


def node_classes(module: object) -> list[type[Node]]:
    """The node classes that a module defines."""
    return [
        kind
        for kind in vars(module).values()
        if inspect.isclass(kind) and issubclass(kind, Node) and kind.__module__ == module.__name__
    ]


def declared(kind: type[Node]) -> list[Parameter]:
    """The parameters that a node's constructor declares before it needs what is not here."""
    node = object.__new__(type("Offline", (kind, Declaring), {}))
    try:
        node.__init__()
    except Exception:  # noqa: BLE001  a robot, weights or a camera is missing: `check` holds that nothing was missed
        pass
    return list(node.declared.values())


def executables(source: Path) -> Iterator[tuple[str, str, str]]:
    """(package, executable, module) of every entry point of the workspace."""
    for setup in sorted(source.glob("*/setup.py")):
        for node in ast.walk(ast.parse(setup.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and ":main" in node.value:
                name, target = (part.strip() for part in node.value.split("="))
                yield setup.parent.name, name, target.split(":")[0]


def check(source: Path, found: dict[str, list[Parameter]]) -> None:
    """Raises ValueError for a parameter that a module declares by name and no node was seen to declare."""
    names = {parameter.name for parameters in found.values() for parameter in parameters}
    for file in sorted(source.glob("*/*/nodes/*.py")):
        for call in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "parameter":
                name = call.args[1]
                if isinstance(name, ast.Constant) and name.value not in names:
                    raise ValueError(f"{file}: parameter {name.value}: expected a node that declares it, found none")


def page(root: Path) -> str:
    """The page. Raises ValueError where a declared parameter was not seen."""
    source = root / "ros2_ws/src"
    found: dict[str, list[Parameter]] = {}
    for package, executable, module in executables(source):
        if ".nodes." in module:
            for kind in node_classes(importlib.import_module(module)):
                found[f"{package} {executable}"] = declared(kind)
    check(source, found)
    parts = [head("Parameters", "the nodes and launch files", INTRODUCTION)]
    parts += [
        "## Launch arguments\n\n`ros2 launch np_bringup task.launch.py name:=value ...`\n\n",
        table(("argument", "default", "meaning"), ((f"`{a.name}`", code(a.default), a.description) for a in ARGUMENTS)),
    ]
    for name, parameters in found.items():
        parts.append(f"\n## {name.split()[1]}\n\n`ros2 run {name}`\n\n")
        if parameters:
            rows = (
                (f"`{p.name}`", type(p.default).__name__, code(p.default), p.allowed, p.meaning) for p in parameters
            )
            parts.append(table(("parameter", "type", "default", "allowed", "meaning"), rows))
        else:
            parts.append("No parameters.\n")
    return "".join(parts)


def code(value: object) -> str:
    """A default as it is typed; nothing for an empty string."""
    if isinstance(value, (float, int)) and not isinstance(value, bool):
        return f"`{number(value)}`" if isinstance(value, float) else f"`{value}`"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f"`{value}`" if value else "empty"
