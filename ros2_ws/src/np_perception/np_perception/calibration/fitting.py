"""From what recordings show of a board to a camera calibration: the fit, its bounds, the table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from np_common.rotations import cross, quaternion_from_matrix
from np_control.kinematics import forward_kinematics
from np_description.calibration import Calibration, CalibrationErrors, TablePlane, norm_bound
from np_description.camera import CAMERA
from np_description.domains import CARD
from np_perception.calibration.board import Board, pose_in_camera
from np_perception.calibration.bundle import BOARD, BundleFit, DegenerateError, TouchedPoint, linearise, refine
from np_perception.calibration.evidence import REST_BEFORE, SHORTEST, CalibrationData, CalibrationRefusal, board_views
from np_perception.calibration.hand_eye import CORNER_SIGMA, ReferenceCheck, check, solve


@dataclass(frozen=True)
class CalibrationResult:
    """A calibration, the lens and the board as its views measure them, and by view (px) how well they fit."""

    calibration: Calibration
    fit: BundleFit
    check: ReferenceCheck


def calibrate(
    evidence: CalibrationData,
    board: Board,
    made: datetime,
    *,
    touched: Sequence[int] = (),
    table: CalibrationData | None = None,
    source: str = "",
    accept: bool = False,
) -> CalibrationResult:
    """The camera, from a board in the hand, or from one on the table whose corners `touched` the fingertip
    stood on.

    touched: numbers of corners, one for each posture at which the arm rested, in that order. table: a
    recording of the board lying on the table, to see where that is. accept: keep a result that contradicts
    the lens or the board's size. Raises CalibrationRefusal.
    """
    _require_board(evidence, board)
    views = board_views(evidence, board, in_hand=not touched)
    try:
        touches = _touches(evidence, board, touched) if touched else []
        fit = solve(views, evidence.lens, touches)
        findings = check(fit, views, touches)
    except DegenerateError as error:
        raise CalibrationRefusal(
            f"{error} ({len(evidence.rests)} postures at rest, the board seen in {len(views)})"
        ) from error
    complaints = findings.complaints()
    if complaints and not accept:
        raise CalibrationRefusal("; ".join(complaints) + ". --accept keeps the result all the same")
    kept = [views[i] for i in fit.used]
    # The images had been turned by `turn`: the camera's own frame is what is kept.
    own = fit.rotation @ evidence.turn
    errors = CalibrationErrors(
        fit.position_95,
        fit.rotation_95,
        keypoint_bound(fit.covariance, fit.dof),
        fit.rms,
        len(kept),
        sum(len(view.points) for view in kept),
    )
    found = find_table(table, board, fit) if table else None
    return CalibrationResult(
        Calibration(
            made,
            evidence.lens,
            fit.position,
            quaternion_from_matrix(own),
            fit.covariance,
            errors,
            found,
            source,
        ),
        fit,
        findings,
    )


def _require_board(evidence: CalibrationData, board: Board) -> None:
    if evidence.detections:
        return
    ours = board.columns * board.rows // 2
    if not evidence.rests:
        raise CalibrationRefusal(
            f"expected the arm to rest for {REST_BEFORE + SHORTEST:g} s at every posture, it never did"
        )
    if not evidence.images:
        taken, begin, end = evidence.taken / 1e9, evidence.rests[0].begin / 1e9, evidence.rests[-1].end / 1e9
        raise CalibrationRefusal(
            f"expected images taken while the arm rested, none of {len(taken)} was: by their stamps they are of {taken.min():.3f} to "
            f"{taken.max():.3f} s, the {len(evidence.rests)} rests of {begin:.3f} to {end:.3f} s"
        )
    others = sorted(number for number in evidence.markers if number >= ours)
    seen = (
        f"markers {others} are on another board"
        if others
        else f"{len(evidence.markers)} of its markers were seen in {evidence.images} images"
    )
    raise CalibrationRefusal(
        f"expected a board of {board.columns} x {board.rows} squares with {ours} markers of"
        f" {board.dictionary}, it was not found: {seen}. Is it this board, sharp, well lit and large enough?"
    )


def _touches(evidence: CalibrationData, board: Board, touched: Sequence[int]) -> list[TouchedPoint]:
    if len(touched) != len(evidence.rests):
        raise CalibrationRefusal(
            f"expected the arm to rest once on each of the {len(touched)} corners named, "
            f"it rested {len(evidence.rests)} times"
        )
    wrong = [corner for corner in touched if not 0 <= corner < len(board.corners)]
    if wrong:
        raise CalibrationRefusal(f"expected corners 0 .. {len(board.corners) - 1}, got {wrong}")
    return [
        TouchedPoint(forward_kinematics(rest.joints)[0], board.corners[corner])
        for rest, corner in zip(evidence.rests, touched)
    ]


def keypoint_bound(covariance: np.ndarray, dof: float) -> float:
    """95 % bound, px, of where the policies' image shows a point on the table, at the worst place of the
    workspace."""
    x, y = np.meshgrid(np.linspace(*CARD.workspace_x, 3), np.linspace(*CARD.workspace_y, 3))
    worst = 0.0
    for point in np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]):
        ray = point - CAMERA.position
        at = ray @ np.asarray(CAMERA.rotation)
        of_optical = np.array(
            [
                [CAMERA.fx / at[2], 0, -CAMERA.fx * at[0] / at[2] ** 2],
                [0, CAMERA.fy / at[2], -CAMERA.fy * at[1] / at[2] ** 2],
            ]
        )
        of_base = of_optical @ np.asarray(CAMERA.rotation).T
        matrix = np.concatenate([-of_base, cross(of_base, np.broadcast_to(ray, of_base.shape))], axis=1)
        worst = max(worst, norm_bound(matrix @ covariance @ matrix.T, dof))
    return worst


def find_table(evidence: CalibrationData, board: Board, fit: BundleFit) -> TablePlane:
    """The table, from a board that lies on it. Raises CalibrationRefusal if it is not seen, or was moved
    meanwhile."""
    _require_board(evidence, board)
    if not np.allclose(evidence.turn, np.eye(3)) or evidence.lens != fit.lens:
        raise CalibrationRefusal(
            "table: expected images of the same camera as in the first recording, camera_info differs"
        )
    views = board_views(evidence, board, in_hand=False)
    lying = [pose_in_camera(view.points, view.pixels, fit.lens) for view in views]
    middles = np.array(
        [fit.rotation @ (turned @ board.corners.mean(axis=0) + at) + fit.position for at, turned in lying]
    )
    if np.ptp(middles, axis=0).max() > 0.01:
        raise CalibrationRefusal(
            "table: expected a board that stays where it lies, it moved by "
            f"{1e3 * np.ptp(middles, axis=0).max():.0f} mm"
        )
    at, turned = lying[0]
    # The board's frame is moved to its middle, so that an error of its tilt does not move it.
    centred = [replace(view, points=view.points - board.corners.mean(axis=0)) for view in views]
    seen = refine(replace(fit, board_position=middles[0], board_rotation=fit.rotation @ turned), centred, (), BOARD)
    rows = linearise(seen, centred[:1])[1].reshape(-1, 16)[:, BOARD]  # further views of the same see no more
    of_board = max(seen.rms, CORNER_SIGMA) ** 2 * np.linalg.inv(rows.T @ rows)
    # An error of the camera moves and tilts what it sees with it; one of the corners found comes on top.
    of_height = np.concatenate([[0, 0, 1], np.cross(seen.board_position - fit.position, [0, 0, 1])])
    height_95 = norm_bound(of_height @ fit.covariance @ of_height + of_board[2, 2], fit.dof)
    tilt_95 = norm_bound(fit.covariance[3:5, 3:5] + of_board[3:5, 3:5], fit.dof)
    normal = -seen.board_rotation[:, 2]  # the board's z goes into the paper
    x, y, height = seen.board_position.tolist()
    return TablePlane(
        height,
        (float(np.arctan2(-normal[1], normal[2])), float(np.arctan2(normal[0], normal[2]))),
        (x, y),
        height_95,
        tilt_95,
    )
