"""`ros2 run` and `ros2 pkg executables`: the ament index, then lib/<package>/."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix, get_packages_with_prefixes


def prefix_of(package: str) -> Path:
    """Where a package is installed. Raises LookupError that names the places searched."""
    try:
        return Path(get_package_prefix(package))
    except (PackageNotFoundError, ValueError) as error:
        searched = os.environ.get("AMENT_PREFIX_PATH", "")
        hint = (
            f"{len(searched.split(os.pathsep))} folders of AMENT_PREFIX_PATH searched"
            if searched
            else "source env.sh first"
        )
        raise LookupError(f"Package '{package}' not found; {hint}; see ros2 pkg executables") from error


def executables(package: str) -> list[Path]:
    """The executables of a package, sorted by name."""
    folder = prefix_of(package) / "lib" / package
    return sorted(p for p in folder.glob("*") if p.is_file() and os.access(p, os.X_OK))


def run(package: str, executable: str, arguments: Sequence[str]) -> int:
    """Become the executable: the process id stays, so that signals reach the node itself."""
    found = {path.name: path for path in executables(package)}
    if executable not in found:
        have = ", ".join(found) or "none"
        raise LookupError(f"No executable '{executable}' in package '{package}'; it has: {have}")
    os.execv(found[executable], [str(found[executable]), *arguments])


def list_executables(package: str | None) -> int:
    """Print `package executable` lines, of one package or of all."""
    for name in [package] if package else sorted(get_packages_with_prefixes()):
        for path in executables(name):
            print(name, path.name)
    return 0
