"""Worker processes that end with whoever started them."""

from __future__ import annotations

import ctypes
import signal
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from multiprocessing import get_context

Workers = Callable[[int], Executor]
_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None)


def end_with_parent() -> None:
    """Ask the kernel (Linux) for SIGTERM when the parent ends, however it ends."""
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def workers(jobs: int) -> ProcessPoolExecutor:
    """So many processes, each started anew."""
    return ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=end_with_parent)
