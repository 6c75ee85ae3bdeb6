"""How much of a core each process took, from the kernel's own account of its threads."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path

TICK = os.sysconf("SC_CLK_TCK")  # of the kernel's account, a second


class CpuShares:
    """Begins to count with its construction. processes: name and process number."""

    def __init__(self, processes: Mapping[str, int]):
        self._processes = dict(processes)
        self._begin, self._before = time.monotonic(), self._read()

    def shares(self) -> dict[str, float]:
        """Shares of one core since the beginning, by process: that of its first thread, then of the others
        (the middleware's)."""
        seconds, now = time.monotonic() - self._begin, self._read()
        return {
            name: round(sum(now[key] - self._before.get(key, 0) for key in now if chosen(key)) / TICK / seconds, 3)
            for process in self._processes
            for name, chosen in (
                (process, lambda key: key[0] == process and key[1]),
                (f"{process}, other threads", lambda key: key[0] == process and not key[1]),
            )
        }

    def _read(self) -> dict[tuple[str, bool, int], int]:
        """Ticks by (process, whether it is the first thread, thread number)."""
        ticks = {}
        for name, pid in self._processes.items():
            for task in Path(f"/proc/{pid}/task").iterdir():
                fields = (task / "stat").read_text().rpartition(")")[2].split()
                # Fields 14 and 15 of proc(5), utime and stime, counted behind the name, which is the second.
                ticks[name, task.name == str(pid), int(task.name)] = int(fields[11]) + int(fields[12])
        return ticks


def children(pid: int) -> list[int]:
    """Process numbers of the children that the first thread has started."""
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
