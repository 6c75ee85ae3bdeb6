"""The end by SIGINT or SIGTERM of commands that look at a graph: noted when it comes, heeded between two steps.

An exception may come at any moment, and rclpy's own handlers shut its context down from another thread: either fails
where it meets rclpy waiting, or shutting down, and the command ends with an error.
"""

from __future__ import annotations

import signal
from types import FrameType

_noted: list[int] = []


def note_signals() -> None:
    """Note signals from now on; the same one a second time ends the process at once."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _note)


def heed() -> None:
    """Raises KeyboardInterrupt once a signal has come."""
    if _noted:
        raise KeyboardInterrupt


def _note(number: int, frame: FrameType | None) -> None:
    _noted.append(number)
    signal.signal(number, signal.SIG_DFL)
