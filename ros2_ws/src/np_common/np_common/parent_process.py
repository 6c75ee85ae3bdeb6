"""Processes that end with their parent."""

from __future__ import annotations

import ctypes
import signal

_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None)  # before any fork: a new process may not load it


def end_with_parent() -> None:
    """Request SIGTERM from the kernel (Linux) when the parent ends, however it ends.

    SIGTERM, not SIGINT: what a shell starts in the background ignores that one until it has made its own handler.
    """
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
