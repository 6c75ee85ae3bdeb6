"""The faces of an object in the colours by which detectors distinguish its corners, on sheets of paper, to scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from np_description.keypoints import CORNERS
from np_description.scene import CORNER_COLOURS
from np_perception.calibration import printing

A4 = printing.A4[::-1]  # upright
DPI = 300
_EDGE, _LABEL = 0.010, 0.007  # m: what printers leave white; beside a face, for the names of its sides
_SCALE = 0.100  # m, a line to measure


@dataclass(frozen=True)
class Face:
    """A face of the object, seen from outside, in the object's frame."""

    out: np.ndarray
    """Unit vector outwards."""
    right: np.ndarray
    """Unit vector to the right."""
    up: np.ndarray
    """Unit vector upwards."""
    size: tuple[float, float]
    """Width and height, m."""

    def keypoint(self, right: int, up: int) -> int:
        """Number of the corner on that side (-1 or 1 each)."""
        return int(np.argmax(CORNERS @ (self.out + right * self.right + up * self.up)))


def faces(half_size: Sequence[float]) -> list[Face]:
    """The six faces of a box with these half edges, m: those at the sides with z up, top and bottom with x up, as the robot sees the top."""
    found = []
    for out in np.vstack([np.eye(3), -np.eye(3)]):
        up = np.eye(3)[0 if out[2] else 2]
        right = np.cross(up, out)
        found.append(Face(out, right, up, tuple(2 * float(np.abs(side) @ half_size) for side in (right, up))))
    return found


def pages(half_size: Sequence[float], title: str, dpi: int = DPI) -> list[np.ndarray]:
    """Sheets of A4 (height, width, 3) uint8 RGB with all faces, each with the names of its sides, and a line of 100 mm.

    Raises ValueError where a face does not fit.
    """
    left, top = _EDGE + _LABEL, 2 * _EDGE + 2 * _LABEL
    room = A4[0] - left - _EDGE - _LABEL, A4[1] - top - _EDGE - _LABEL
    sheets: list[np.ndarray] = []
    x = y = row = float("inf")
    for face in sorted(faces(half_size), key=lambda face: -face.size[1]):
        width, height = face.size
        if width > room[0] or height > room[1]:
            raise ValueError(
                f"object: expected faces of at most {room[0]:.3f} x {room[1]:.3f} m, which fit on A4, got {width:.3f} x {height:.3f} m"
            )
        if x + width > room[0]:
            x, y, row = 0.0, y + row, height + 3 * _LABEL
        if y + height > room[1]:
            sheets.append(_blank(title, dpi))
            x, y, row = 0.0, 0.0, height + 3 * _LABEL
        _draw(sheets[-1], face, left + x, top + y, dpi)
        x += width + 3 * _LABEL
    return sheets


def _px(metres: float, dpi: int) -> int:
    return round(metres / printing.INCH * dpi)


def _blank(title: str, dpi: int) -> np.ndarray:
    sheet = np.full((_px(A4[1], dpi), _px(A4[0], dpi), 3), 255, np.uint8)
    _write(sheet, f"{title}. Print at 100 %: the line is 100 mm long.", _EDGE, _EDGE + 0.004, dpi)
    start, end, y = _px(_EDGE, dpi), _px(_EDGE, dpi) + _px(_SCALE, dpi), _px(_EDGE + 0.008, dpi)
    cv2.line(sheet, (start, y), (end, y), (0, 0, 0), max(1, dpi // 150))
    return sheet


def _draw(sheet: np.ndarray, face: Face, left: float, top: float, dpi: int) -> None:
    width, height = face.size
    columns = [_px(left + share * width, dpi) for share in (0.0, 0.5, 1.0)]
    rows = [_px(top + share * height, dpi) for share in (0.0, 0.5, 1.0)]
    for i, right in enumerate((-1, 1)):
        for j, up in enumerate((1, -1)):
            colour = np.rint(255 * np.asarray(CORNER_COLOURS[face.keypoint(right, up)]))
            sheet[rows[j] : rows[j + 1], columns[i] : columns[i + 1]] = colour
    _write(sheet, f"face {_name(face.out)}, up {_name(face.up)}", left, top - 0.002, dpi)
    _write(sheet, _name(-face.right), left - 0.006, top + height / 2 + 0.001, dpi)
    _write(sheet, _name(face.right), left + width + 0.001, top + height / 2 + 0.001, dpi)
    _write(sheet, _name(-face.up), left + width / 2 - 0.002, top + height + 0.004, dpi)


def _name(direction: np.ndarray) -> str:
    axis = int(np.argmax(np.abs(direction)))
    return f"{'+' if direction[axis] > 0 else '-'}{'xyz'[axis]}"


def _write(sheet: np.ndarray, text: str, x: float, y: float, dpi: int) -> None:
    where = (_px(x, dpi), _px(y, dpi))
    cv2.putText(sheet, text, where, cv2.FONT_HERSHEY_SIMPLEX, dpi / 350, (0, 0, 0), max(1, dpi // 150), cv2.LINE_AA)
