"""The log of a run: a CSV file, one row an iteration, which survives a kill and changes of its columns."""

from __future__ import annotations

import csv
import os
from pathlib import Path


def _records(path: Path) -> tuple[list[str], list[list[str]]]:
    """Column names and rows; a row cut short by a kill is left out."""
    if not path.exists():
        return [], []
    whole = [line for line in path.read_text().splitlines(keepends=True) if line.endswith("\n")]
    names, *rows = list(csv.reader(whole)) or [[]]
    return names, [row for row in rows if len(row) == len(names)]


def read_log(path: Path) -> list[dict[str, float]]:
    """Rows in the order of iterations. Of an iteration logged twice, by a run that was killed and resumed
    from a checkpoint further back, the later row. Columns that a row does not have are NaN."""
    names, rows = _records(path)
    parsed = [{name: float(text) if text else float("nan") for name, text in zip(names, row)} for row in rows]
    return [row for _, row in sorted({row["iteration"]: row for row in parsed}.items())]


class TrainingLog:
    """Appends rows. A file with other columns, or whose last row was cut short, is rewritten first, keeping
    its rows."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.names, rows = _records(path)
        if path.exists():
            self._rewrite(rows)

    def write(self, row: dict[str, float]) -> None:
        """Append a row; new names become new columns."""
        new = [name for name in row if name not in self.names]
        if new:
            old, rows = self.names, _records(self.path)[1]
            self.names = old + new
            self._rewrite([values + [""] * len(new) for values in rows])
        with self.path.open("a", newline="") as file:
            csv.writer(file).writerow(
                [f"{row[n]:.6g}" if isinstance(row.get(n), float) else row.get(n, "") for n in self.names]
            )

    def _rewrite(self, rows: list[list[str]]) -> None:
        partial = self.path.with_suffix(".partial")
        with partial.open("w", newline="") as file:
            csv.writer(file).writerows([self.names, *rows])
        os.replace(partial, self.path)
