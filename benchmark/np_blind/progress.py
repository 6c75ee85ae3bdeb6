"""A progress bar that needs nothing."""

from __future__ import annotations

import sys
import time


class Bar:
    """A bar on a terminal; elsewhere a line now and then."""

    def __init__(self, total: int, what: str):
        self._total, self._what, self._began, self._next = total, what, time.monotonic(), 0.0

    def show(self, done: int, text: str = "") -> None:
        """Show `done` of the total and a few words."""
        live = sys.stderr.isatty()
        if not live and done < min(self._next, self._total):
            return
        self._next = done + self._total / 20
        filled = int(24 * done / max(self._total, 1))
        line = (
            f"{self._what} [{'#' * filled}{'.' * (24 - filled)}] {done}/{self._total} "
            f"{time.monotonic() - self._began:4.0f} s  {text}"
        )
        end = "" if live and done < self._total else "\n"
        print(f"\r\x1b[K{line}" if live else line, end=end, file=sys.stderr, flush=True)
