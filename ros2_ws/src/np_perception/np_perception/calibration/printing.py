"""The calibration board on a sheet of paper, to scale."""

from __future__ import annotations

import cv2
import numpy as np

from np_perception.calibration.board import Board, BoardError

DPI = 600
INCH = 0.0254  # m
A4 = (0.297, 0.210)  # m, landscape


def page(board: Board, dpi: int = DPI) -> np.ndarray:
    """The page (height, width) uint8: the board in the middle. Raises BoardError if it does not fit."""
    if any(side > sheet for side, sheet in zip(board.size, A4)):
        raise BoardError(
            f"board: expected one that fits on A4 ({A4[0]} x {A4[1]} m), this is {board.size[0]:.3f} x "
            f"{board.size[1]:.3f} m"
        )
    width, height = (round(side / INCH * dpi) for side in A4)
    sheet = np.full((height, width), 255, np.uint8)
    picture = board.picture(dpi / INCH)
    top, left = (height - picture.shape[0]) // 2, (width - picture.shape[1]) // 2
    sheet[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    text = (
        f"{board.columns} x {board.rows} squares of {1e3 * board.square:g} mm, markers {1e3 * board.marker:g}"
        f" mm, {board.dictionary}. Print at 100 %, measure, and say what you measured: --square --marker"
    )
    if top > 60:
        cv2.putText(sheet, text, (left, height - top // 3), cv2.FONT_HERSHEY_SIMPLEX, dpi / 450, 0, max(1, dpi // 300))
    return sheet
