"""Who does the cases of a long job: processes of this machine, or those of a Dask cluster.

A case is a function at the top of a module and its arguments, and leaves what it found in files of a folder that every machine sees.
"""

from __future__ import annotations

import ctypes
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from importlib.util import find_spec
from multiprocessing import get_context

Workers = Callable[[int], AbstractContextManager[Executor]]
"""So many processes, as long as the context lasts."""
LOCAL = "local"
HELP = (
    "address of a Dask scheduler, as tcp://host:8786; local: one on this machine, with its dashboard; "
    "default: processes of this machine without Dask"
)
LOSSES = 1  # how often a case may lose the worker it runs on; the next time it fails
_CONNECT = 20.0  # s
_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None)


def end_with_parent() -> None:
    """Ask the kernel (Linux) for SIGTERM when the parent ends, however it ends."""
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def missing(cluster: str) -> str:
    """What is not installed of what `cluster` needs, in words; "" for nothing."""
    if cluster and find_spec("distributed") is None:
        return f"{cluster}: expected the package distributed, which `make cluster` installs"
    return ""


def workers(jobs: int, cluster: str = "") -> AbstractContextManager[Executor]:
    """An executor of `jobs` processes, each started anew; of a cluster that is elsewhere, of all the workers that it has.

    A cluster gives the case of a worker that is lost to another, once (a scheduler of your own: as it was told). Without one,
    all cases that are left raise BrokenProcessPool. Raises OSError for a cluster that does not answer, or without Dask.
    """
    if not cluster:
        return ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=end_with_parent)
    if problem := missing(cluster):
        raise OSError(problem)
    return _on_dask(jobs, cluster)


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
                yield client.get_executor(pure=False)
        finally:
            if started is not None:
                started.close()
