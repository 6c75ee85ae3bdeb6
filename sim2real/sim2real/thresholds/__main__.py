"""Prints the thresholds as a Markdown table."""

from __future__ import annotations

from sim2real.thresholds import THRESHOLDS
from sim2real.thresholds.entry import table

if __name__ == "__main__":
    print(table(THRESHOLDS), end="")
