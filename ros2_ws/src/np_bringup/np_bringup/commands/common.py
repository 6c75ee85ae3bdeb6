"""What the commands share: a running graph, the origin of a run, progress, the end on a signal."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from np_description.domains import find_domain
from np_description.released import WeightsError, sha256, weights_folder

from np_bringup.backends import SIMULATED
from np_bringup.card import card_graph
from np_bringup.nodes.conductor_node import Conductor
from np_bringup.supervisor import Supervisor

INTERRUPTED = 130  # the exit status of a command ended by Ctrl-C


@contextmanager
def running_graph(arguments: Mapping[str, str], logs: Path, **callbacks) -> Iterator[Conductor]:
    """The card graph, up and ready, and a conductor for it; every process is ended on the way out.

    callbacks as for Conductor. Raises what Supervisor.start and Conductor.wait_until_ready raise.
    """
    specs = card_graph(arguments)
    domain = find_domain(arguments.get("domain", "card"))
    lockstep = arguments.get("mode", "lockstep") == "lockstep"
    with Supervisor(logs) as supervisor:
        supervisor.start(specs)
        backend = arguments.get("backend", SIMULATED)
        with Conductor(supervisor, domain, lockstep=lockstep, backend=backend, **callbacks) as conductor:
            conductor.wait_until_ready(specs)
            yield conductor


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
