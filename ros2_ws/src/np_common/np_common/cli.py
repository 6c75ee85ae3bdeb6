"""Shared parts of commands: options, new folders, progress, interruption."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path
from typing import NoReturn

from tqdm import tqdm

INTERRUPTED = 130  # the exit status of a command ended by Ctrl-C


class Parser(argparse.ArgumentParser):
    """The options of a command. An error prints one line, without the usage of many lines that argparse prints first."""

    def error(self, message: str) -> NoReturn:
        """End the command with status 2."""
        self.exit(2, f"{self.prog}: {message}; see --help\n")


def new_folder(base: Path) -> Path:
    """The first of <base>_000, <base>_001, ... that does not exist, made. Raises OSError naming one that cannot be made."""
    number = 0
    while True:
        path = base.with_name(f"{base.name}_{number:03d}")
        try:
            path.mkdir(parents=True)
            return path
        except FileExistsError:
            number += 1
        except OSError as error:
            raise OSError(f"{path}: expected a folder that can be made, got: {error.strerror}") from error


def interrupt_on_sigterm() -> None:
    """Let SIGTERM, and the SIGHUP of a terminal that is closed, end the command as Ctrl-C does, with everything cleaned up."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # nohup
        signal.signal(signal.SIGHUP, signal.default_int_handler)


class Progress:
    """A bar with the time left on a terminal; elsewhere a line now and then."""

    def __init__(self, total: int, what: str):
        self._total, self._what = total, what
        self._bar: _Bar | None = None

    def show(self, done: float, text: str = "") -> None:
        """Show `done` of the total and a short text; not on a terminal, a line every 5 % at most."""
        if self._bar is None:
            is_live = sys.stderr.isatty()
            self._bar = _Bar(
                position=0,  # where several are shown at once, none moves the cursor for the others
                total=self._total,
                initial=done,
                desc=self._what,
                postfix=text,
                file=sys.stderr if is_live else _Lines(),
                mininterval=0.1 if is_live else 0.0,
                miniters=0 if is_live else max(1, self._total // 20),
                dynamic_ncols=is_live,
                bar_format="{desc} |{bar:24}| {done}/{total_fmt} {elapsed}<{remaining}{postfix}",
            )
        self._bar.set_postfix_str(text, refresh=False)
        self._bar.update(done - self._bar.n)
        if done >= self._total:
            self._bar.close()


class _Bar(tqdm):
    """A bar without the thread that would redraw it: what is forked must not have threads."""

    monitor_interval = 0

    @property
    def format_dict(self) -> dict:
        return {**super().format_dict, "done": int(self.n)}


class _Lines:
    """A stream on which every state of a bar is a line of its own, since it cannot be drawn over."""

    def __init__(self):
        self._last = ""

    def write(self, text: str) -> None:
        line = text.strip()
        if line and line != self._last:  # the end is drawn twice
            print(line, file=sys.stderr, flush=True)
            self._last = line

    def flush(self) -> None:
        sys.stderr.flush()
