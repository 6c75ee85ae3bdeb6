"""How long `--help` of every command and node takes: processor time in s, the slowest first. `python tools/help_times.py [NAME...]`

A command reads its command line first and imports what is slow after; `tests/np_evaluation/test_command.py` holds that none imports PyTorch.
"""

from __future__ import annotations

import re
import resource
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ASK = "import importlib, sys; sys.argv = [{0!r}, '--help']; importlib.import_module({0!r}).main()"


def commands() -> list[str]:
    """The module of every command and node: entry points of the workspace, what of training and blind tests runs by itself."""
    told = "".join(path.read_text() for path in sorted((ROOT / "ros2_ws/src").glob("*/setup.py")))
    alone = [
        ".".join(path.relative_to(folder).with_suffix("").parts)
        for folder in (ROOT / "training", ROOT / "benchmark")
        for path in sorted(folder.rglob("*.py"))
        if "__main__" in path.read_text()
    ]
    return [*re.findall(r"= (np_[\w.]+):main", told), *alone]


def taken(name: str) -> float:
    """Processor time, s, of a process that prints a command's help. Raises CalledProcessError where there is none."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", ASK.format(name)], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    for seconds, name in sorted(((taken(name), name) for name in sys.argv[1:] or commands()), reverse=True):
        print(f"{seconds:5.2f}  {name}")
