"""Memory, handles and threads of processes, from /proc, and whether they stay."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class ResourceUse:
    """Use of one process."""

    memory: int
    """Resident memory that it has written, alone or shared, kB; pages of program files do not count, the kernel loads and drops them."""
    handles: int
    """Open file handles."""
    threads: int
    """Number of threads."""


def measure_use(pid: int) -> ResourceUse:
    """The present use of a process. Raises OSError where it has ended."""
    folder = Path("/proc") / str(pid)
    lines = dict(line.split(":", 1) for line in (folder / "status").read_text().splitlines() if ":" in line)
    own = sum(int(lines[kind].split()[0]) for kind in ("RssAnon", "RssShmem"))
    return ResourceUse(own, len(list((folder / "fd").iterdir())), int(lines["Threads"]))


def processor_seconds(pid: int) -> float:
    """Processor time s that a process and its threads have used. Raises OSError where it has ended."""
    fields = (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Trend:
    """Use of one process over the episodes after the warm-up."""

    memory: tuple[int, int]
    """At the beginning and at the end, medians of a tenth each, kB."""
    memory_per_episode: float
    """Slope of a line through all, kB."""
    handles: tuple[int, int]
    """At the beginning and at the end."""
    threads: tuple[int, int]
    """At the beginning and at the end."""

    def is_flat(self, memory_per_episode: float) -> bool:
        """Whether nothing grows: handles and threads not at all, memory by less than so many kB an episode."""
        grown = self.handles[1] > self.handles[0] or self.threads[1] > self.threads[0]
        return not grown and self.memory_per_episode < memory_per_episode


def trend(uses: Sequence[ResourceUse], warm: int) -> Trend:
    """The trend of one process, one entry an episode. Raises ValueError where fewer than ten are left after the warm-up."""
    kept = uses[warm:]
    if len(kept) < 10:
        raise ValueError(f"trend: expected at least 10 episodes after {warm} of warm-up, got {len(kept)}")
    part = max(1, len(kept) // 10)
    memory = np.array([use.memory for use in kept], float)
    slope = float(np.polyfit(np.arange(len(memory)), memory, 1)[0])

    def ends(values: list[int]) -> tuple[int, int]:
        return int(np.median(values[:part])), int(np.median(values[-part:]))

    return Trend(
        ends([use.memory for use in kept]),
        round(slope, 2),
        ends([use.handles for use in kept]),
        ends([use.threads for use in kept]),
    )


def find_growing(trends: Mapping[str, Trend], memory_per_episode: float) -> list[str]:
    """The processes that are not flat."""
    return [name for name, one in trends.items() if not one.is_flat(memory_per_episode)]
