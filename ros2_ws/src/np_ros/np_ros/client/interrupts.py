"""Interrupts that wait: Ctrl-C between two callbacks, as nodes end, for commands that are ended by KeyboardInterrupt."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def defer_interrupts() -> Iterator[None]:
    """Whatever handlers of the process do with SIGINT, SIGTERM and SIGHUP, they do it after the block.

    rclpy turns a KeyboardInterrupt that is raised while it converts a message into a TypeError. Code that expects the one
    does not catch the other. In a thread that no signal reaches nothing happens. Keep the block short.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[tuple] = []
    handlers = {number: signal.getsignal(number) for number in _NUMBERS}
    handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
    for number in handlers:
        signal.signal(number, lambda *arguments: came.append(arguments))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number, frame in came[:1]:
            handlers[number](number, frame)
