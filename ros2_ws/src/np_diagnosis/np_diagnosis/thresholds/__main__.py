"""Prints the thresholds as a Markdown table."""

from __future__ import annotations

from np_diagnosis.thresholds import THRESHOLDS
from np_diagnosis.thresholds.entry import table

if __name__ == "__main__":
    print(table(THRESHOLDS), end="")
