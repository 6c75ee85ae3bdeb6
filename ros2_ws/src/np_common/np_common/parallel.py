"""Executors for the cases of a long job: processes of this machine, or workers of a Dask cluster.

A case is a function at the top of a module and its arguments, and leaves what it found in files of a folder that every machine sees.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from importlib.util import find_spec
from multiprocessing import active_children, get_context
from threading import Condition, Lock, local

from np_common.parent_process import end_with_parent

Workers = Callable[[int], AbstractContextManager[Executor]]
"""So many processes, as long as the context lasts."""
LOCAL = "local"
SINGLE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of processes of which each has a core."""
HELP = (
    "address of a Dask scheduler, as tcp://host:8786; local: one on this machine, with its dashboard; "
    "default: processes of this machine without Dask"
)
LOSSES = 1  # how often a case may lose the worker it runs on; the next time it fails
_CONNECT = 20.0  # s
_MOST = 1024  # cases at a time


def missing(cluster: str) -> str:
    """An error text for the missing package that `cluster` needs; empty where none is missing."""
    if cluster and find_spec("distributed") is None:
        return f"{cluster}: expected the package distributed, which `make cluster` installs"
    return ""


def workers(jobs: int, cluster: str = "") -> AbstractContextManager[Executor]:
    """An executor of `jobs` processes, each started anew; of a cluster that is elsewhere, of all the workers that it has.

    Where its context is left by an exception, cases under way on this machine are interrupted and no further one is begun.
    The case of a worker that is lost is done by another, once (a scheduler of your own: as it is configured); the next time its
    future raises: BrokenProcessPool, of a cluster KilledWorker. Raises OSError for a cluster that does not reply, or without Dask.
    """
    if not cluster:
        return _on_this_machine(jobs)
    if problem := missing(cluster):
        raise OSError(problem)
    return _on_dask(jobs, cluster)


@contextmanager
def _on_this_machine(jobs: int) -> Iterator[Executor]:
    pool = _Processes(jobs)
    try:
        yield pool
    except BaseException:  # else every case that was handed in would be done before the command ends
        pool.end()
        raise
    finally:
        pool.shutdown()


class _Processes(ThreadPoolExecutor):
    """Threads with a process each, which does one case after another: a killed process costs only its own case a try.

    Each thread starts its own process: the kernel signals a process at the end of the thread that started it, not of the command.
    """

    def __init__(self, jobs: int):
        super().__init__(jobs)
        self._own, self._starting, self._is_ending = local(), Lock(), False
        self._others = set(active_children())

    def submit(self, case, /, *arguments, **named) -> Future:
        return super().submit(self._try, case, arguments, named)

    def end(self) -> None:
        """Interrupt what is under way: a process with SIGTERM ends together with its present case, which cleans up."""
        with self._starting:
            self._is_ending = True
        self.shutdown(wait=False, cancel_futures=True)
        ending = set(active_children()) - self._others
        for process in ending:
            process.terminate()
        for process in ending:
            process.join()

    def _try(self, case, arguments, named):
        for left in reversed(range(LOSSES + 1)):
            try:
                return self._begun(case, arguments, named).result()
            except BrokenProcessPool:
                del self._own.process
                if not left:
                    raise

    def _begun(self, case, arguments, named) -> Future:
        with self._starting:
            if self._is_ending:
                raise CancelledError
            if not hasattr(self._own, "process"):
                self._own.process = ProcessPoolExecutor(1, get_context("spawn"), _begin)
            return self._own.process.submit(_do, case, *arguments, **named)


_told_to_end: list[int] = []  # signals that this process was sent during a case
_at_work: list[Callable] = []  # the case that it is at


def _begin() -> None:
    end_with_parent()
    signal.signal(signal.SIGTERM, _end)


def _end(number, frame) -> None:
    if not _at_work:
        os._exit(128 + number)
    _told_to_end.append(number)
    # The kernel sends it once for every thread of the parent that a process was handed to: cleaning up is not to be interrupted again.
    if len(_told_to_end) == 1:
        raise KeyboardInterrupt  # so that the case ends what it has started


def _do(case, /, *arguments, **named):
    _at_work.append(case)
    try:
        return case(*arguments, **named)
    finally:
        if (
            _told_to_end
        ):  # its result is not awaited, and nothing else would end this process where the parent was killed
            os._exit(128 + _told_to_end[0])
        _at_work.pop()


@contextmanager
def _on_dask(jobs: int, cluster: str) -> Iterator[Executor]:
    import dask
    from distributed import Client, LocalCluster

    with dask.config.set(
        {"distributed.scheduler.allowed-failures": LOSSES, "distributed.comm.timeouts.connect": _CONNECT}
    ):
        started = LocalCluster(n_workers=jobs, threads_per_worker=1) if cluster == LOCAL else None
        try:
            with Client(started or cluster, timeout=_CONNECT) as client:
                print(f"dashboard: {client.dashboard_link}", file=sys.stderr)
                with _OneEach(client) as pool:
                    try:
                        yield pool
                    except BaseException:
                        pool.shutdown(wait=False, cancel_futures=True)
                        client.close()  # futures that wait for a case raise
                        raise
        finally:
            if started is not None:
                started.close()


class _OneEach(ThreadPoolExecutor):
    """Hands a cluster no more cases than it has threads, however many those become: one that waits behind another on a worker that is
    lost would be blamed for it too."""

    def __init__(self, client):
        super().__init__(_MOST)
        self._client, self._busy, self._free = client, 0, Condition()

    def submit(self, case, /, *arguments, **named) -> Future:
        return super().submit(self._do, case, arguments, named)

    def _do(self, case, arguments, named):
        with self._free:
            while self._busy >= sum(self._client.nthreads().values()):
                self._free.wait(1.0)
            self._busy += 1
        try:
            return self._client.submit(case, *arguments, **named, pure=False).result()
        finally:
            with self._free:
                self._busy -= 1
                self._free.notify()
