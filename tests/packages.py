"""The packages of this project, read from their sources: who imports whom, and which tests belong to whom."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {path.parent.name: path.parent for path in sorted((ROOT / "ros2_ws/src").glob("*/package.xml"))}
ABOVE = {"np_training": ROOT / "training", "np_blind": ROOT / "benchmark"}

FLOORS = (
    {"np_common"},
    {"np_description"},
    {"np_ros"},
    {"np_record"},
    {"np_control"},
    {"np_perception", "np_planning"},
    {"np_policy", "sim2real"},
    {"np_sim_bridge"},
    {"np_franka", "np_diagnosis", "np_physx_bridge"},
    {"np_bringup"},
    {"np_evaluation"},
    {"np_training", "np_blind"},
)
"""From low to high: a package imports only from those below its own floor, those of the last also from each other."""

FLOOR = {name: level for level, names in enumerate(FLOORS) for name in names}


@cache
def modules() -> dict[str, Path]:
    """Every module of the project by its name."""
    found = {}
    for name, folder in {**PACKAGES, **ABOVE}.items():
        for path in (folder / name).rglob("*.py"):
            parts = path.relative_to(folder).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def sources(package: str) -> list[Path]:
    """The Python files of a package of the workspace, launch files included."""
    return [*(PACKAGES[package] / package).rglob("*.py"), *PACKAGES[package].glob("launch/*.py")]


@cache
def tree(path: Path) -> ast.Module:
    """The syntax tree of a file."""
    return ast.parse(path.read_text(), path)


@cache
def imports(path: Path) -> tuple[str, ...]:
    """The modules that a file imports, in functions as well; `from a import b` is a.b where that is a module of ours.

    Raises ValueError for an import relative to the file.
    """
    found: list[str] = []
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                raise ValueError(f"{path}, line {node.lineno}: expected an absolute import")
            for alias in node.names:
                inside = f"{node.module}.{alias.name}"
                found.append(inside if inside in modules() else node.module)
    return tuple(found)


def packages_of(path: Path) -> set[str]:
    """The packages of this project that a file imports."""
    return {name.partition(".")[0] for name in imports(path)} & FLOOR.keys()


def own_tests(package: str) -> list[Path]:
    """The files of tests without a graph that belong to a package: those in the folder of its name."""
    return sorted((ROOT / "tests" / package).glob("test_*.py"))
