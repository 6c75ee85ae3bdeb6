"""docs/reference/parameters.md: parameters of every node and arguments of every launch file, from what they declare."""

from __future__ import annotations

import ast
import importlib
import inspect
from collections.abc import Iterator
from pathlib import Path

from rclpy.node import Node

from np_bringup.task_graph import ARGUMENTS
from np_ros.parameters import NodeParameter, list_parameters
from pages.markdown import head, number, table

INTRODUCTION = """Generated from the code. A parameter is set at the start (`--ros-args -p name:=value`) and read-only afterwards.
Values of another type or out of range, and unknown names, are refused. The meaning states the unit. `ros2 run PACKAGE NODE --help` prints the same."""


def node_classes(module: object) -> list[type[Node]]:
    """The node classes that a module defines."""
    return [
        kind
        for kind in vars(module).values()
        if inspect.isclass(kind) and issubclass(kind, Node) and kind.__module__ == module.__name__
    ]


def executables(source: Path) -> Iterator[tuple[str, str, str]]:
    """(package, executable, module) of every entry point of the workspace."""
    for setup in sorted(source.glob("*/setup.py")):
        for node in ast.walk(ast.parse(setup.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and ":main" in node.value:
                name, target = (part.strip() for part in node.value.split("="))
                yield setup.parent.name, name, target.split(":")[0]


def check(source: Path, found: dict[str, list[NodeParameter]]) -> None:
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
    found: dict[str, list[NodeParameter]] = {}
    for package, executable, module in executables(source):
        if ".nodes." in module:
            for kind in node_classes(importlib.import_module(module)):
                found[f"{package} {executable}"] = list_parameters(kind)
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
