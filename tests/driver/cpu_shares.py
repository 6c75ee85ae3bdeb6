"""How much of a core each process took, from the kernel's own account of its threads."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path

STEAL = 7  # among the uses of the machine's time
TICK = os.sysconf("SC_CLK_TCK")  # of the kernel's account, a second


class CpuShares:
    """Begins to count with its construction. processes: name and process number."""

    def __init__(self, processes: Mapping[str, int]):
        self._processes = dict(processes)
        self._begin, self._before = time.monotonic(), self._read()
        self._machine = _machine()

    def stolen(self) -> float:
        """Share of the machine's time since the beginning that its host gave to other machines."""
        passed = [now - before for now, before in zip(_machine(), self._machine)]
        return round(passed[STEAL] / max(sum(passed), 1), 3)

    def shares(self) -> dict[str, float]:
        """Shares of one core since the beginning, by process: that of its first thread, then of the others
        (the middleware's)."""
        now, ticks = self._read(), TICK * (time.monotonic() - self._begin)
        shares = {}
        for process in self._processes:
            for name, is_first in ((process, True), (f"{process}, other threads", False)):
                took = [now[key] - self._before.get(key, 0) for key in now if key[:2] == (process, is_first)]
                shares[name] = round(sum(took) / ticks, 3)
        return shares

    def _read(self) -> dict[tuple[str, bool, int], int]:
        """Ticks by (process, whether it is the first thread, thread number)."""
        ticks = {}
        for name, pid in self._processes.items():
            for task in Path(f"/proc/{pid}/task").iterdir():
                fields = (task / "stat").read_text().rpartition(")")[2].split()
                # Fields 14 and 15 of proc(5), utime and stime, counted behind the name, which is the second.
                ticks[name, task.name == str(pid), int(task.name)] = int(fields[11]) + int(fields[12])
        return ticks


def _machine() -> list[int]:
    """Ticks of all cores by use: the first eight of the line `cpu` of proc(5)'s stat."""
    return [int(field) for field in Path("/proc/stat").read_text().splitlines()[0].split()[1:9]]


def children(pid: int) -> list[int]:
    """Process numbers of the children that the first thread has started."""
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
