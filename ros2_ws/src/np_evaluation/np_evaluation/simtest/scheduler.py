"""Simulated time: a queue of events, and the clocks, locks and disk that nodes find in place of the machine's."""

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

from np_record import bag_writer
from np_ros.processes import domain

SECOND = 1_000_000_000
_EPOCH = 1_700_000_000 * SECOND  # ns, the wall clock at the beginning of a run
_PACKAGES = ("np_ros.", "np_policy.", "np_control.", "np_planning.", "np_perception.", "np_sim_bridge.", "np_record.")


class Scheduler:
    """Runs events in the order of their time; equal times in the order in which they were asked for.

    rng: draws everything that a run leaves to chance.
    """

    def __init__(self, seed: int):
        self.rng = random.Random(seed)
        self.now = SECOND
        """ns of the steady clock."""
        self.wall_offset = _EPOCH
        """ns from the steady clock to the wall clock; a clock jump changes it."""
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._number = count()

    @property
    def wall(self) -> int:
        """ns of the wall clock."""
        return self.now + self.wall_offset

    def at(self, when: int, action: Callable[[], None]) -> None:
        """Run `action` at `when` ns, or now where that is past."""
        heapq.heappush(self._events, (when if when > self.now else self.now, next(self._number), action))

    def after(self, delay: int, action: Callable[[], None]) -> None:
        """Run `action` in `delay` ns."""
        self.at(self.now + delay, action)

    def run_until(self, end: int) -> None:
        """Run every event up to `end` ns. An event may call this itself: a callback that sleeps lets others run."""
        events, take = self._events, heapq.heappop
        while events and events[0][0] <= end:
            when, _, action = take(events)
            if when > self.now:
                self.now = when
            action()
        self.now = max(self.now, end)

    def draw(self, low: float, high: float) -> int:
        """A time in ns between two in ms, small ones more often (log-uniform)."""
        return int(1e6 * math.exp(self.rng.uniform(math.log(low), math.log(high))))


class _Time:
    """The module `time` of a node."""

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
    """The files by which processes of one machine exclude each other."""

    def __init__(self) -> None:
        self._held: set[str] = set()

    def lock(self, path) -> SimpleNamespace | None:
        """As np_ros.processes.locks.lock."""
        name = str(path)
        if name in self._held:
            return None
        self._held.add(name)
        return SimpleNamespace(close=lambda: self._held.discard(name))

    def release_all(self) -> None:
        """The only process that takes a lock has died."""
        self._held.clear()


class Disk:
    """The disk of the recorder; `room`: bytes until it is full, None for no end."""

    def __init__(self) -> None:
        self.room: int | None = None

    def file(self, *arguments) -> io.FileIO:
        """A file without a buffer on this disk, as the writer of bags opens it."""
        file = _FileOnDisk(*arguments)
        file.disk = self
        return file


class _FileOnDisk(bag_writer._Unbuffered):
    disk: Disk

    def write(self, data) -> int:
        data, room = memoryview(data).cast("B"), self.disk.room
        if room is not None and len(data) > room:
            super().write(data[:room])
            self.disk.room = None  # the writer keeps room for the end of a bag, and frees it before it writes that end
            raise OSError(errno.ENOSPC, "No space left on device")
        self.disk.room = None if room is None else room - len(data)
        return super().write(data)


class _TurnQueue:
    """A queue whose `put` waits until the item has been used: the thread behind it runs at the same point in every run."""

    def __init__(self) -> None:
        self._items: list = []
        self._filled, self._used = threading.Semaphore(0), threading.Semaphore(0)
        self._began = self._is_dead = False

    def put(self, item) -> None:
        if self._is_dead:  # killed while a callback slept: the callback does not go on
            raise SystemExit
        self._items.append(item)
        self._filled.release()
        if item is not None:  # after None its user ends, and is joined
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
        """End the thread as the death of its process does."""
        self._is_dead = True
        self._items.append(Disk)
        self._filled.release()


@contextmanager
def simulate_host(scheduler: Scheduler, locks: Locks, disk: Disk) -> Iterator[None]:
    """Inside, the project's modules have the simulated clock, locks and disk in place of the machine's.

    A module is given what it imported by name; what every process of its own would do to the collector of memory is left out.
    """
    clock, collector = _Time(scheduler), SimpleNamespace(collect=lambda: 0, freeze=lambda: None)
    changes = [(domain, "lock", locks.lock), (bag_writer, "SimpleQueue", _TurnQueue)]
    changes.append((bag_writer, "_Unbuffered", disk.file))
    for name, module in list(sys.modules.items()):
        if name.startswith(_PACKAGES):
            changes += [(module, "time", clock)] * (getattr(module, "time", None) is time)
            changes += [(module, "gc", collector)] * (getattr(module, "gc", None) is gc)
    before = [(module, name, getattr(module, name)) for module, name, _ in changes]
    for module, name, value in changes:
        setattr(module, name, value)
    try:
        yield
    finally:
        for module, name, value in before:
            setattr(module, name, value)
