"""`pip_progress.py COUNT pip install ... [--and pip install ...]`: runs pip, or several in parallel, and prints its progress
and the time left; pip itself prints nothing for minutes.

A package is half done when pip has found it and done when it is unpacked. On a terminal one line is drawn over; elsewhere a line
comes every tenth. Needs nothing but Python, for it runs before anything is installed. The exit status is that of the first pip
that failed.
"""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import threading
import time
from pathlib import Path

PERIOD = 1.0  # s


class Bar:
    """How far `total` steps are; begun at `began` s by the clock of `now`."""

    def __init__(self, total: int, is_live: bool, began: float):
        self._total, self._is_live, self._began = max(1, total), is_live, began
        self._told = -1

    def text(self, done: float, what: str, now: float) -> str:
        """One line, or "" where nothing is new."""
        share = min(1.0, done / self._total)
        tenth = int(10 * share)
        if not self._is_live and tenth == self._told:
            return ""
        self._told = tenth
        left = f", about {(now - self._began) * (1 - share) / share:.0f} s left" if 0.02 < share < 1 else ""
        return f"  {100 * share:3.0f} %  {what}{left}"


def count_installed(folder: Path) -> int:
    """How many packages lie unpacked there."""
    return sum(1 for _ in folder.glob("*.dist-info"))


def find_name(line: str) -> str:
    """The package that pip has found by a line of its output, or ""."""
    first, _, rest = line.strip().partition(" ")
    return rest.split()[0] if first == "Collecting" and rest else ""


def split_commands(arguments: list[str]) -> list[list[str]]:
    """The commands between which `--and` stands."""
    commands: list[list[str]] = [[]]
    for one in arguments:
        commands.append([]) if one == "--and" else commands[-1].append(one)
    return commands


def run(count: int, commands: list[list[str]], folder: Path) -> int:
    """Run pips, which unpack to `folder`; the exit status of the first that failed."""
    is_live = sys.stderr.isatty()
    bar, before = Bar(2 * count, is_live, time.monotonic()), count_installed(folder)
    names: list[str] = []
    done = threading.Event()

    def watch() -> None:
        while not done.wait(PERIOD):
            unpacked = count_installed(folder) - before
            what = f"{unpacked} of {count} installed" if unpacked else f"{len(names)} of {count} found"
            if text := bar.text(len(names) + unpacked, what, time.monotonic()):
                print(f"\r\033[K{text}" if is_live else text, end="" if is_live else "\n", file=sys.stderr, flush=True)

    def listen(pip: subprocess.Popen) -> None:
        for line in pip.stdout:
            names.extend([name] if (name := find_name(line)) else [])

    pips = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for command in commands]
    listeners = [threading.Thread(target=listen, args=[pip]) for pip in pips]
    watcher = threading.Thread(target=watch, daemon=True)
    for thread in (watcher, *listeners):
        thread.start()
    for thread in listeners:
        thread.join()
    statuses = [pip.wait() for pip in pips]
    done.set()
    watcher.join()
    if is_live:
        print("\r\033[K", end="", file=sys.stderr, flush=True)
    return next((status for status in statuses if status), 0)


if __name__ == "__main__":
    sys.exit(run(int(sys.argv[1]), split_commands(sys.argv[2:]), Path(sysconfig.get_path("purelib"))))
