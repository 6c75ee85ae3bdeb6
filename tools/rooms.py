"""The packages by what they hold and whom they import, as a Markdown table: `python tools/rooms.py [CHECKOUT]`.

Lines and arrows are counted from the sources, lazy imports too. An arrow is a pair of packages; beside it, how many files draw it.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from pathlib import Path

ROOMS = ("ros2_ws/src/*/np_*", "training/np_*", "benchmark/np_*")


def packages(root: Path) -> dict[str, list[Path]]:
    """Python files of each package."""
    folders = [f for pattern in ROOMS for f in sorted(root.glob(pattern)) if (f / "__init__.py").exists()]
    return {folder.name: sorted(folder.rglob("*.py")) for folder in folders}


def imported(path: Path, own: str) -> set[str]:
    """Packages of the project that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add((node.module or "").partition(".")[0])
    return {name for name in found if name.startswith("np_") and name != own}


def table(root: Path) -> str:
    """A row a package: lines, modules, the largest folder of modules side by side, and its arrows."""
    rows = ["| package | lines | modules | most side by side | imports (files that do) |", "|---|---|---|---|---|"]
    total, arrows = 0, 0
    for name, files in packages(root).items():
        lines = sum(len(f.read_text(encoding="utf-8").splitlines()) for f in files)
        beside = max(Counter(f.parent for f in files if f.name != "__init__.py").values())
        drawn = Counter(other for f in files for other in imported(f, name))
        rows.append(
            f"| `{name}` | {lines} | {len(files)} | {beside} | "
            f"{', '.join(f'{other} {count}' for other, count in sorted(drawn.items()))} |"
        )
        total, arrows = total + lines, arrows + len(drawn)
    return "\n".join([*rows, f"| all | {total} | | | {arrows} arrows |"])


if __name__ == "__main__":
    print(table(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1]))
