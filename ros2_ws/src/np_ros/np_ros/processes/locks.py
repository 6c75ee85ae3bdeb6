"""Locks between processes of this machine, also of several users: files that are locked while a process has them open."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import TextIO


def lock(path: Path) -> TextIO | None:
    """The open file that holds the lock until it is closed, or its process ends; None where another process has it.

    Raises OSError for a file that cannot be opened.
    """
    handle = _open(path)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return handle
    except OSError:
        handle.close()
        return None


def _open(path: Path) -> TextIO:
    """The file at `path`, made if it is not there, open for reading: a lock needs no more, and every user may.

    Another user's file cannot be opened for writing, nor, in a folder such as /tmp, with O_CREAT, for reading either
    (fs.protected_regular). Raises OSError for one that cannot be read.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CREAT | os.O_EXCL, 0o644)
        os.fchmod(descriptor, 0o644)  # whatever the umask
    except FileExistsError:
        descriptor = os.open(path, os.O_RDONLY)
    return os.fdopen(descriptor)
