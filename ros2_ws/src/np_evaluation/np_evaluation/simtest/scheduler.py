"""Simulated time: a queue of events, and the clocks, locks and disk that replace the machine's for nodes."""

from __future__ import annotations

import errno
import gc
import heapq
import io
import math
import random
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from types import SimpleNamespace

from np_description.control_rate import SECOND
from np_record import bag_writer
from np_ros.processes import domain

_EPOCH = 1_700_000_000 * SECOND  # ns, wall clock at the start of a run
_PACKAGES = ("np_ros.", "np_policy.", "np_control.", "np_planning.", "np_perception.", "np_sim_bridge.", "np_record.")


class Scheduler:
    """Runs events in order of time; events of equal time in order of scheduling.

    rng: the source of all random draws of a run.
    """

    def __init__(self, seed: int):
        self.rng = random.Random(seed)
        self.now = SECOND
        """Steady clock, ns."""
        self.wall_offset = _EPOCH
        """Wall clock minus steady clock, ns; a clock jump changes it."""
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._number = count()

    @property
    def wall(self) -> int:
        """Wall clock, ns."""
        return self.now + self.wall_offset

    def call_at(self, when: int, action: Callable[[], None]) -> None:
        """Run `action` at `when` ns, or now if that is past."""
        heapq.heappush(self._events, (when if when > self.now else self.now, next(self._number), action))

    def call_after(self, delay: int, action: Callable[[], None]) -> None:
        """Run `action` in `delay` ns."""
        self.call_at(self.now + delay, action)

    def run_until(self, end: int) -> None:
        """Run every event up to `end` ns. An event may call this too: other events run while a callback sleeps."""
        events, take = self._events, heapq.heappop
        while events and events[0][0] <= end:
            when, _, action = take(events)
            if when > self.now:
                self.now = when
            action()
        self.now = max(self.now, end)

    def draw_time(self, low: float, high: float) -> int:
        """Draw a log-uniform time between `low` and `high` ms; returns ns."""
        return int(1e6 * math.exp(self.rng.uniform(math.log(low), math.log(high))))


class _Time:
    """Replaces the module `time` for nodes."""

    def __init__(self, scheduler: Scheduler):
        self._scheduler = scheduler

    def monotonic(self) -> float:
        return self._scheduler.now * 1e-9

    def monotonic_ns(self) -> int:
        return self._scheduler.now

    def time(self) -> float:
        return self._scheduler.wall * 1e-9

    def time_ns(self) -> int:
        return self._scheduler.wall

    def sleep(self, seconds: float) -> None:
        self._scheduler.run_until(self._scheduler.now + round(seconds * SECOND))


class Locks:
    """Replaces the lock files of the machine."""

    def __init__(self) -> None:
        self._held: set[str] = set()

    def lock(self, path) -> SimpleNamespace | None:
        """Take a lock as np_ros.processes.locks.lock does; None if it is held."""
        name = str(path)
        if name in self._held:
            return None
        self._held.add(name)
        return SimpleNamespace(close=lambda: self._held.discard(name))

    def release_all(self) -> None:
        """Release all locks, after the death of the only process that takes one."""
        self._held.clear()


class Disk:
    """The disk of the recorder; `room`: bytes until it is full, None for unlimited."""

    def __init__(self) -> None:
        self.room: int | None = None

    def open_file(self, *arguments) -> io.FileIO:
        """Open an unbuffered file on this disk for the bag writer."""
        file = _FileOnDisk(*arguments)
        file.disk = self
        return file


class _FileOnDisk(bag_writer._Unbuffered):
    disk: Disk

    def write(self, data) -> int:
        data, room = memoryview(data).cast("B"), self.disk.room
        if room is not None and len(data) > room:
            super().write(data[:room])
            # The bag writer reserves room for the end of a bag and frees it before it writes that end.
            self.disk.room = None
            raise OSError(errno.ENOSPC, "No space left on device")
        self.disk.room = None if room is None else room - len(data)
        return super().write(data)


class _TurnQueue:
    """A queue whose `put` waits until the consumer is done with the item, so that every run is deterministic."""

    def __init__(self) -> None:
        self._items: list = []
        self._filled, self._used = threading.Semaphore(0), threading.Semaphore(0)
        self._began = self._is_dead = False

    def put(self, item) -> None:
        if self._is_dead:  # killed while a callback slept: the callback must not continue
            raise SystemExit
        self._items.append(item)
        self._filled.release()
        if item is not None:  # None ends the consumer, which the caller then joins
            self._used.acquire()

    def get(self):
        if self._began:
            self._used.release()
        self._began = True
        self._filled.acquire()
        item = self._items.pop()
        if item is Disk:  # the process was killed
            raise SystemExit
        return item

    def kill(self) -> None:
        """End the consumer's thread, as the death of its process does."""
        self._is_dead = True
        self._items.append(Disk)
        self._filled.release()


@contextmanager
def simulate_host(scheduler: Scheduler, locks: Locks, disk: Disk) -> Iterator[None]:
    """Replace the machine's clock, locks and disk in the project's modules inside this context.

    Only modules that are loaded and import `time` or `gc` by name change; garbage collection requested by a node has no effect.
    """
    clock, collector = _Time(scheduler), SimpleNamespace(collect=lambda: 0, freeze=lambda: None)
    changes = [(domain, "lock", locks.lock), (bag_writer, "SimpleQueue", _TurnQueue)]
    changes.append((bag_writer, "_Unbuffered", disk.open_file))
    for name, module in list(sys.modules.items()):
        if name.startswith(_PACKAGES):
            changes += [(module, "time", clock)] * (getattr(module, "time", None) is time)
            changes += [(module, "gc", collector)] * (getattr(module, "gc", None) is gc)
    originals = [(module, name, getattr(module, name)) for module, name, _ in changes]
    for module, name, value in changes:
        setattr(module, name, value)
    try:
        yield
    finally:
        for module, name, value in originals:
            setattr(module, name, value)
