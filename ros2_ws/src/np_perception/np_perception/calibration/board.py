"""The calibration board (ChArUco): a chessboard whose white squares carry markers, so that every corner has a
number.

Parts of it may be hidden. Corners are those inside the board, row by row from the origin; the board's frame
has x along its columns, y along its rows and z into the paper, as OpenCV lays it out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from np_description.calibration import Lens
from np_perception.calibration.board_layout import BoardLayout

MIN_CORNERS = 8
_ENLARGED_BELOW = 24.0  # px, side of a marker: smaller ones are looked for in an image of twice the size
_MARGIN = 0.004  # m of white around the squares: without it the outermost markers are not found


class BoardError(ValueError):
    """A board that cannot be, or that is not the one in the images."""


@dataclass(frozen=True)
class Board(BoardLayout):
    """A board of this layout, to draw and to find in images. Raises BoardError for what cannot be printed."""

    def __post_init__(self) -> None:
        if not hasattr(cv2.aruco, self.dictionary) or not self.dictionary.startswith("DICT_"):
            raise BoardError(f"board: expected one of OpenCV's dictionaries, as DICT_4X4_50, got {self.dictionary!r}")
        if min(self.columns, self.rows) < 3 or not 0 < self.marker < self.square:
            raise BoardError(f"board: expected 3 x 3 squares or more and markers smaller than squares, got {self}")
        if self.columns * self.rows // 2 > len(self._dictionary.bytesList):
            raise BoardError(
                f"board: {self.dictionary} has {len(self._dictionary.bytesList)} markers, "
                f"{self.columns} x {self.rows} squares need {self.columns * self.rows // 2}"
            )

    @cached_property
    def _dictionary(self):
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    @cached_property
    def _board(self):
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, self._dictionary)
        board.setLegacyPattern(self.is_legacy)
        return board

    @cached_property
    def _detector(self):
        return cv2.aruco.CharucoDetector(self._board)

    @cached_property
    def corners(self) -> np.ndarray:
        """Positions (n, 3) m of the corners in the board's frame; z = 0."""
        return np.asarray(self._board.getChessboardCorners(), float)

    @property
    def size(self) -> tuple[float, float]:
        """Width and height m of what is printed, its white margin included."""
        return self.columns * self.square + 2 * _MARGIN, self.rows * self.square + 2 * _MARGIN

    def picture(self, pixels_per_metre: float) -> np.ndarray:
        """The board to print or to draw, (height, width) uint8, with its margin: `size` times
        `pixels_per_metre`."""
        width, height = (round(side * pixels_per_metre) for side in self.size)
        return self._board.generateImage((width, height), marginSize=round(_MARGIN * pixels_per_metre), borderBits=1)

    def detect(self, image: np.ndarray) -> BoardDetection:
        """The corners in an image (height, width, 3) uint8 RGB."""
        grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
        found = self._detect(grey)
        sides = [np.linalg.norm(np.diff(marker[0], axis=0), axis=1).mean() for marker in found[2] or ()]
        if not sides or np.median(sides) < _ENLARGED_BELOW:
            twice = self._detect(cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC))
            if _count(twice) >= _count(found):
                # Centres of pixels, not their edges
                corners = None if twice[0] is None else (twice[0] + 0.5) / 2 - 0.5
                found = (corners, *twice[1:])
        corners, ids, _, markers = found
        markers = np.zeros(0, int) if markers is None else markers.ravel()
        if corners is None or ids is None:
            return BoardDetection(np.zeros(0, int), np.zeros((0, 2)), markers)
        ids, pixels = ids.ravel(), corners.reshape(-1, 2).astype(float)
        inside = ids < len(self.corners)
        return BoardDetection(ids[inside], pixels[inside], markers)

    def _detect(self, grey: np.ndarray):
        return self._detector.detectBoard(grey)


def _count(found) -> int:
    return 0 if found[1] is None else len(found[1])


@dataclass(frozen=True)
class BoardDetection:
    """ids (n,): numbers of the corners found; pixels (n, 2); markers (m,): numbers of the markers found."""

    ids: np.ndarray
    pixels: np.ndarray
    markers: np.ndarray

    @property
    def is_usable(self) -> bool:
        """Whether it fixes the board's pose: enough corners, and not all in one row."""
        return len(self.ids) >= MIN_CORNERS and bool(
            np.linalg.svd(self.pixels - self.pixels.mean(axis=0), compute_uv=False)[1] > 5.0
        )


def undistort(pixels: np.ndarray, lens: Lens) -> np.ndarray:
    """Where the pixels (n, 2) would be without the lens's distortion, with the same K."""
    if not any(lens.distortion):
        return np.asarray(pixels, float)
    k = lens.matrix
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-9)
    return cv2.undistortPoints(
        np.asarray(pixels, float)[:, None], k, np.asarray(lens.distortion), P=k, criteria=criteria
    )[:, 0]


def pose_in_camera(points: np.ndarray, pixels: np.ndarray, lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) m and rotation (3, 3) of a board in the camera, from points (n, 3) m and undistorted
    pixels (n, 2).

    Of the two poses that explain a plane's image (Collins and Bartoli, 2014) the better one, refined. Raises
    BoardError.
    """
    points, pixels = np.asarray(points, float), np.asarray(pixels, float)
    count, turns, shifts, errors = cv2.solvePnPGeneric(points, pixels, lens.matrix, None, flags=cv2.SOLVEPNP_IPPE)
    finite = [i for i in range(count) if np.isfinite(turns[i]).all() and np.isfinite(shifts[i]).all()]
    if not finite:
        raise BoardError("board: no pose explains its corners")
    best = min(finite, key=lambda i: errors[i].item())
    turn, shift = cv2.solvePnPRefineLM(points, pixels, lens.matrix, None, turns[best].copy(), shifts[best].copy())
    return shift.ravel(), cv2.Rodrigues(turn)[0]
