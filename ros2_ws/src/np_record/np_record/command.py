"""What commands share: the origin of a run, folders that are new, progress, the end on a signal."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

from np_description.released import WeightsError, sha256, weights_folder

INTERRUPTED = 130  # the exit status of a command ended by Ctrl-C


def origin(weights: str = "") -> dict[str, object]:
    """Where a run comes from: git revision ("" outside a working tree), SHA-256 of every released weight."""
    command = [
        "git",
        "-C",
        str(Path(__file__).resolve().parent),
        "describe",
        "--always",
        "--dirty",
        "--abbrev=12",
    ]
    try:
        revision = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        revision = ""
    try:
        folder = weights_folder(weights)
        files = sorted([*folder.glob("*.safetensors"), *folder.glob("*.onnx")])
        hashes = {path.name: sha256(path) for path in files}
    except WeightsError:
        hashes = {}  # the nodes that need them say so
    return {"revision": revision, "weights_sha256": hashes}


def new_folder(base: Path) -> Path:
    """The first of <base>_000, <base>_001, ... that does not exist, made."""
    number = 0
    while True:
        path = base.with_name(f"{base.name}_{number:03d}")
        try:
            path.mkdir(parents=True)
            return path
        except FileExistsError:
            number += 1


def interrupt_on_sigterm() -> None:
    """Let SIGTERM end the command as Ctrl-C does, with everything cleaned up."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)


class Progress:
    """A bar on a terminal; elsewhere a line now and then."""

    def __init__(self, total: int, what: str):
        self._total, self._what = total, what
        self._began = time.monotonic()
        self._live = sys.stderr.isatty()
        self._next = 0

    def show(self, done: float, text: str = "") -> None:
        """Show `done` of the total and a few words; not on a terminal, a line every 5 % at most."""
        if not self._live:
            if done < min(self._next, self._total):
                return
            self._next = int(done) + max(1, self._total // 20)
        share = done / max(self._total, 1)
        filled = int(24 * share)
        line = (
            f"{self._what} [{'#' * filled}{'.' * (24 - filled)}] {int(done)}/{self._total} "
            f"{time.monotonic() - self._began:4.0f} s  {text}"
        )
        if self._live:
            print(f"\r\x1b[K{line}", end="" if done < self._total else "\n", file=sys.stderr, flush=True)
        else:
            print(line, file=sys.stderr, flush=True)
