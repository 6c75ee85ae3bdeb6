"""The excitation suite of np_diagnosis through the driver, by the command that records any backend."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path

from graph_tools import command
from moving_arm import MovingArm

TIMEOUT = 1200.0  # s, beyond which a suite hangs


def record(arm: MovingArm, folder: Path, only: Sequence[str] = ()) -> dict:
    """Run `excite --backend running --mode realtime` beside driver and controller; what it prints. Raises
    RuntimeError with its last words where it does not succeed.

    only: names of experiments, all by default; the bag and the logs are put into `folder`.
    """
    options = [
        "--backend",
        "running",
        "--mode",
        "realtime",
        "--out",
        str(folder / "bag"),
        "--logs",
        str(folder / "log"),
        *(["--only", *only] if only else []),
    ]
    return _run([*command("np_diagnosis", "excite"), *options], folder / "excite.txt", arm)


def diagnose(bag: str, folder: Path) -> dict:
    """Run `diagnose --quick` on a bag; what it prints. Raises RuntimeError, for a broken contract too."""
    return _run(
        [*command("np_diagnosis", "diagnose"), bag, "--out", str(folder / "report"), "--quick"], folder / "diagnose.txt"
    )


def _run(line: list[str], log: Path, arm: MovingArm | None = None) -> dict:
    environment = {**os.environ, **(arm.harness.graph.environment if arm else {})}
    with (
        open(log, "w") as errors,
        subprocess.Popen(line, env=environment, stdout=subprocess.PIPE, stderr=errors, text=True) as process,
    ):
        try:
            if arm is not None:
                arm.harness.probe.wait_until(lambda: process.poll() is not None, TIMEOUT, line[0])
            output, _ = process.communicate()
        except BaseException:
            process.terminate()
            raise
    if process.returncode:
        raise RuntimeError(f"{' '.join(line)} ended with {process.returncode}: {log.read_text()[-1000:]}")
    return json.loads(output.splitlines()[-1])
