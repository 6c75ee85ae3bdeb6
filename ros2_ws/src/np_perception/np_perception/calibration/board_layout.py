"""Which calibration board it is, in numbers: apart from what finds it, whose libraries are slow to import."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BoardLayout:
    """columns, rows: squares; square, marker: sides m; dictionary: OpenCV's name of the set of markers.

    The default fits on A4.
    """

    columns: int = 7
    rows: int = 5
    square: float = 0.036
    marker: float = 0.027
    dictionary: str = "DICT_4X4_50"
