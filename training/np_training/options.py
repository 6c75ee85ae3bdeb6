"""Numbers of command lines: a time or a count that cannot be is refused by name before anything starts."""

from __future__ import annotations

import argparse
import math


def duration(text: str) -> float:
    """A finite number of at least 0, for `type` of an option. Raises ArgumentTypeError, which argparse prints with the option's name."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"expected a number of at least 0, got {text!r}")
    return value


def count(text: str) -> int:
    """A whole number of at least 1, likewise."""
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got {text!r}")
    return value
