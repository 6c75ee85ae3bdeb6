"""Which calibration board it is, in numbers: apart from what finds it, whose libraries are slow to import."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BoardLayout:
    """Squares and markers of a board; the default fits on A4."""

    columns: int = 7
    """Squares in a row."""
    rows: int = 5
    """Squares in a column."""
    square: float = 0.036
    """Side m of a square."""
    marker: float = 0.027
    """Side m of a marker."""
    dictionary: str = "DICT_4X4_50"
    """OpenCV's name of the set of markers."""
    is_legacy: bool = False
    """Whether it is laid out as by OpenCV before 4.6: with an even number of rows it begins with a white square."""
