"""What a terminal shows of a run: one line that is written over; elsewhere, a line a minute."""

from __future__ import annotations

import math
import sys
import time
from typing import TextIO

from np_training.ppo.curriculum import STAGES


class TrainingProgress:
    """every: seconds between lines where the stream is no terminal; the first row is always shown."""

    def __init__(self, stream: TextIO | None = None, every: float = 60.0) -> None:
        self._stream = stream or sys.stderr
        self._live, self._every, self._next = self._stream.isatty(), every, -math.inf

    def show(self, row: dict[str, float], left: float) -> None:
        """Show a row of the log and the seconds that are left."""
        if self._live:
            print(f"\r\x1b[K{describe(row, left)}", end="", file=self._stream, flush=True)
        elif time.monotonic() >= self._next:
            self._next = time.monotonic() + self._every
            print(describe(row, left), file=self._stream, flush=True)

    def end(self) -> None:
        """Leave the line."""
        if self._live:
            print(file=self._stream, flush=True)


def describe(row: dict[str, float], left: float) -> str:
    """A row of the log in one line; success also by groups of tasks, where there are any
    (`breakdown.groups`)."""
    groups = " ".join(
        f"{name[8:]} {value:.2f}" for name, value in row.items() if name.startswith(("success_tips", "success_goal"))
    )
    practised = " ".join(
        f"{name[8:]} {value:.2f}"
        for name, value in row.items()
        if name.startswith("success_") and not name.startswith(("success_tips", "success_goal", "success_mean"))
    )
    practice = f"practice {row['practice']:.2f}: {practised}" if row.get("practice") else ""
    grown = row.get("randomisation", 0.0)
    stage = f"randomised {grown:.0%}" if grown else f"stage {row['stage']:2d}/{STAGES}"
    trouble = f"{row['overflowed']:.0f} worlds over capacity" if row.get("overflowed") else ""
    parts = [
        f"{row['steps'] / 1e6:7.1f} M steps",
        f"{row['steps_per_second'] / 1e3:5.1f} k/s",
        stage,
        f"success {row['success']:.3f}",
        groups,
        practice,
        f"lost {row['lost']:.3f}",
        f"force {row['force_median']:.0f} N, 99 % {row['force_q99']:.0f}, stopped {row['pressed']:.3f}"
        if "force_q99" in row
        else "",
        f"length {row['length']:5.1f}",
        f"end {1e3 * row['end_distance']:5.1f} mm {row['end_angle']:.2f} rad",
        f"feasible {row['pre_feasible']:.2f}",
        f"std {row['std']:.2f}",
        f"kl {row['kl']:.4f}",
        trouble,
        f"{left / 60:.1f} min left",
    ]
    return "  ".join(part for part in parts if part)
