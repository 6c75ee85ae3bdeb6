"""Who is served first: what others wait for goes before what nobody waits for, and when the time is over nothing more is begun.

A pool of processes takes cases in the order in which they come. Hundreds of episodes that may be played at any time would then stand in front of
the recording that a diagnosis, a training and the last episodes wait for.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from functools import partial
from itertools import count
from threading import RLock

DOCTOR, REHEARSAL, ENGINE = range(3)
"""Ranks: recordings and what is made of them; what the simulator predicts and what came of training; all that is only judged by."""

AT_ONCE = 1024  # cases that a cluster is handed


class TimeOver(Exception):
    """Nothing more is begun."""

    def __str__(self) -> str:
        return "the time was over"


class Queue:
    """Hands a pool at most `at_once` cases at a time, those of a lower rank first. until: Unix s from which none is begun any more: futures of
    those that wait then raise TimeOver."""

    def __init__(self, pool: Executor, at_once: int, until: float = float("inf")):
        self._pool, self._free, self._until = pool, at_once, until
        self._waiting: list[tuple] = []
        self._number, self._lock = count(), RLock()  # a case may be done before the pool says that it has it

    @property
    def is_over(self) -> bool:
        """Whether the time is over."""
        return time.time() > self._until

    def check(self, seconds: float = 0.0) -> None:
        """Raises TimeOver where less than `seconds` are left."""
        if time.time() + seconds > self._until:
            raise TimeOver

    def left(self, grace: float = 0.0) -> float | None:
        """s up to the end of the time, and `grace`; None where it has none."""
        return None if self._until == float("inf") else max(self._until - time.time(), 0.0) + grace

    def end(self) -> None:
        """Let the time be over now."""
        with self._lock:
            self._until = 0.0
            self._fill()

    def ranked(self, rank: int) -> Ranked:
        """The same as an executor, all of whose cases have that rank."""
        return Ranked(partial(self._submit, rank))

    def _submit(self, rank: int, case: Callable, arguments: tuple, named: dict) -> Future:
        future: Future = Future()
        with self._lock:
            heapq.heappush(self._waiting, (rank, next(self._number), future, case, arguments, named))
            self._fill()
        return future

    def _fill(self) -> None:
        while self._waiting and (self._free or self.is_over):
            *_, future, case, arguments, named = heapq.heappop(self._waiting)
            if not future.set_running_or_notify_cancel():
                continue
            if self.is_over:
                future.set_exception(TimeOver())
                continue
            self._free -= 1
            try:
                self._pool.submit(case, *arguments, **named).add_done_callback(partial(self._done, future))
            except RuntimeError as error:  # a pool that is being closed
                self._free += 1
                future.set_exception(error)

    def _done(self, future: Future, inner: Future) -> None:
        with self._lock:
            self._free += 1
            self._fill()
        if inner.cancelled():
            future.set_exception(CancelledError())
        elif error := inner.exception():
            future.set_exception(error)
        else:
            future.set_result(inner.result())


class Ranked(Executor):
    """Cases of one rank of a queue."""

    def __init__(self, submit: Callable[[Callable, tuple, dict], Future]):
        self._submit = submit

    def submit(self, case, /, *arguments, **named) -> Future:
        """As an executor does."""
        return self._submit(case, arguments, named)
