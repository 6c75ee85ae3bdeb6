"""What may come next on the command line, for the shell's Tab: commands, packages, executables, launch arguments, topics, services.

`env.sh` makes bash (and zsh, through bashcompinit) call `ros2 --complete`; bash passes the words in COMP_LINE and COMP_POINT.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence

from ament_index_python.packages import get_packages_with_prefixes

from ros2_lite import launch, packages


def words(environment: Mapping[str, str]) -> tuple[list[str], str]:
    """The words before the one that is being typed, `ros2` left out, and that one so far."""
    line = environment.get("COMP_LINE", "")
    line = line[: int(environment.get("COMP_POINT", len(line)))]
    before = line.split()
    typed = "" if line.endswith(" ") or not before else before.pop()
    return before[1:], typed


def candidates(root: argparse.ArgumentParser, before: Sequence[str], typed: str) -> list[str]:
    """What begins with `typed` and may stand after `before`."""
    try:
        choices = _choices(root, list(before), typed)
    except (LookupError, OSError, ValueError):
        return []
    return sorted(choice for choice in choices if choice.startswith(typed))


def _choices(parser: argparse.ArgumentParser, before: list[str], typed: str) -> list[str]:
    path = []
    while before and (verbs := _verbs(parser)):
        if before[0] not in verbs:
            return []
        path.append(before[0])
        parser = verbs[before.pop(0)]
    if verbs := _verbs(parser):
        return list(verbs)
    if typed.startswith("-"):
        return [option for action in parser._actions for option in action.option_strings]
    values = [word for word in before if not word.startswith("-")]
    match path, len(values):
        case ((["run"] | ["launch"] | ["pkg", _]), 0):
            return list(get_packages_with_prefixes())
        case ["run"], 1:
            return [executable.name for executable in packages.executables(values[0])]
        case ["launch"], 1:
            return [file.name for file in launch.files(values[0])]
        case ["launch"], _:
            return [f"{argument.name}:=" for argument in launch.load(values[0], values[1])["ARGUMENTS"]]
        case ["topic", "echo" | "hz" | "info" | "pub"], 0:
            return [name for name, _ in _graph("get_topic_names_and_types")]
        case ["service", "call"], 0:
            return [name for name, _ in _graph("get_service_names_and_types")]
        case ["service", "call"], 1:
            return [t for name, types in _graph("get_service_names_and_types") for t in types if name == values[0]]
    return []


def _verbs(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The sub-commands of a parser, by name."""
    found = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return dict(found[0].choices) if found else {}


def _graph(method: str) -> list[tuple[str, list[str]]]:
    """Names and types in the ROS domain."""
    from ros2_lite import graph

    with graph.node() as node:
        return graph.discover(node, getattr(node, method))
