"""Hand-eye calibration: a fixed camera sees a board that the hand holds, or one on the table that the
fingertip touches.

Unknown are the camera in the base frame and the board on whatever carries it (the hand, or the table). The
start comes from the closed form of Park and Martin (IEEE T-RA 10(5), 1994) on random triples of views. The best
triple is taken, so that a few wrong views do no harm. Then all corners of all views are fitted at
once: Gauss-Newton on Huber-weighted reprojection errors.

Errors of the arm's kinematics move all corners of a view together, so views, not corners, are the independent
pieces of evidence: the covariance is that of leaving out one view at a time (jackknife).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from np_common.rotations import vector_from_matrix
from np_description.calibration import Lens, norm_bound
from np_perception.calibration.board import pose_in_camera
from np_perception.calibration.bundle import (
    LENS,
    POSES,
    SCALE,
    BoardView,
    BundleFit,
    DegenerateError,
    TouchedPoint,
    estimate_errors,
    linearise,
    refine,
    residuals,
)

MIN_VIEWS = 8
MIN_TOUCHES = 6
# Of the hand's orientations: standard deviation about the axis about which it turned second most.
MIN_TURN = np.radians(8)
# Of the touched points: standard deviation m in the direction in which they spread second most.
MIN_SPREAD = 0.03
MAX_RMS = 3.0  # px; more than this is another board, another lens or another robot
MAX_POSITION, MAX_ROTATION = 0.02, np.radians(2)  # 95 % bounds from which nothing can be projected
_WRONG_VIEW = 4.0  # times the median error of the views
CORNER_SIGMA = 0.1  # px, by which a corner may be off in every image of a board that lies still
_HYPOTHESES = 60


@dataclass(frozen=True)
class ReferenceCheck:
    """What was taken as known, as the same views measure it.

    focal: factor on the focal length; centre (2,) px: shift of the principal point, both fitted together;
    scale: factor on the board's size, fitted alone; *_95: half widths of their 95 % intervals.
    """

    focal: float
    focal_95: float
    centre: np.ndarray
    centre_95: np.ndarray
    scale: float
    scale_95: float

    def complaints(self) -> list[str]:
        """What differs from what was taken as known: outside twice its interval, and by enough to matter."""
        found = []
        if abs(self.scale - 1) > max(2 * self.scale_95, 0.003):
            found.append(
                f"the board looks {self.scale:.4f} +- {self.scale_95:.4f} times its size: is it printed to scale?"
            )
        if abs(self.focal - 1) > max(2 * self.focal_95, 0.01):
            found.append(f"the focal length looks {self.focal:.4f} +- {self.focal_95:.4f} times that of camera_info")
        if (np.abs(self.centre) > np.maximum(2 * self.centre_95, 4.0)).any():
            found.append(
                f"the principal point looks shifted by {np.round(self.centre, 1).tolist()} +- "
                f"{np.round(self.centre_95, 1).tolist()} px from that of camera_info"
            )
        return found


def solve(views: Sequence[BoardView], lens: Lens, touches: Sequence[TouchedPoint] = ()) -> BundleFit:
    """The camera from views of a board in the hand, or, with touches, on the table.

    Raises DegenerateError for too few views, too little movement, or views that no camera explains.
    """
    views, touches = list(views), list(touches)
    (_require_touches if touches else _require_views)(views, touches)
    start = _start_from_touches(views, lens, touches) if touches else _start(views, lens)
    fit, right = estimate_errors(start, views), np.arange(len(views))
    for _ in range(3):  # wrong views must not pull at the fit by which they are found wrong
        right = np.flatnonzero(fit.view_rms <= max(_WRONG_VIEW * np.median(fit.view_rms), 0.5))
        fit = estimate_errors(refine(fit, [views[i] for i in right], touches), views)
    if len(right) < max(len(views) * 2 / 3, 1 if touches else MIN_VIEWS) or fit.rms > MAX_RMS:
        raise DegenerateError(
            f"expected views that one camera explains within {MAX_RMS:g} px, errors by view are "
            f"{np.round(fit.view_rms, 2).tolist()} px{_hint(fit, views, touches)}"
        )
    kept = [views[i] for i in right]
    fit = replace(refine(fit, kept, touches), used=tuple(right.tolist()), left_out=len(views) - len(right))
    (_require_touches if touches else _require_views)(kept, touches)
    covariance, dof = _jackknife(fit, kept, touches)
    fit = replace(fit, covariance=covariance, dof=dof)
    if not (fit.position_95 <= MAX_POSITION and fit.rotation_95 <= MAX_ROTATION):
        raise DegenerateError(
            f"expected to know the camera within {1e3 * MAX_POSITION:g} mm and "
            f"{np.degrees(MAX_ROTATION):g} degrees, these views leave {1e3 * fit.position_95:.1f} mm and "
            f"{np.degrees(fit.rotation_95):.2f} degrees: take more, in more different orientations"
        )
    return fit


def check(fit: BundleFit, views: Sequence[BoardView], touches: Sequence[TouchedPoint] = ()) -> ReferenceCheck:
    """Fit the lens, then the board's size too, with intervals from leaving out one piece of evidence at a
    time."""
    kept = [views[i] for i in fit.used]

    def lens_values(other: BundleFit) -> np.ndarray:
        return np.array([other.lens.fx / fit.lens.fx, other.lens.cx - fit.lens.cx, other.lens.cy - fit.lens.cy])

    def scale_value(other: BundleFit) -> np.ndarray:
        return np.array([other.scale])

    results = []
    for free, value in (*(() if touches else ((LENS, lens_values),)), (SCALE, scale_value)):
        full = refine(fit, kept, touches, free)
        values = _left_out(full, kept, touches, value, free)
        spread = np.sqrt(np.diag(_jackknife_covariance(values)))
        results.append((value(full), np.array([norm_bound([[s**2]], len(values) - 1) for s in spread])))
    scale, scale_95 = results[-1]
    # A board that lies still is one view: the lens cannot be fitted to it.
    lens, lens_95 = results[0] if not touches else (np.array([1.0, 0.0, 0.0]), np.full(3, np.inf))
    return ReferenceCheck(lens[0], lens_95[0], lens[1:], lens_95[1:], scale[0], scale_95[0])


# Conditions


def _require_views(views: list[BoardView], _touches: list[TouchedPoint]) -> None:
    if len(views) < MIN_VIEWS:
        raise DegenerateError(f"expected at least {MIN_VIEWS} views, got {len(views)}")
    turns = np.array([vector_from_matrix(views[0].rotation.T @ view.rotation) for view in views])
    spread = np.linalg.svd(turns - turns.mean(axis=0), compute_uv=False) / np.sqrt(len(views))
    if spread[1] < MIN_TURN:
        raise DegenerateError(
            f"expected orientations of the hand that differ by {np.degrees(MIN_TURN):.0f} degrees (standard"
            f" deviation) about two axes, got {', '.join(f'{s:.1f}' for s in np.degrees(spread))} degrees:"
            " the camera's position is not determined"
        )


def _require_touches(views: list[BoardView], touches: list[TouchedPoint]) -> None:
    if not views:
        raise DegenerateError("expected at least one view of the board on the table, got none")
    points = np.array([touch.point for touch in touches])
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    if len(touches) < MIN_TOUCHES or spread[1] < MIN_SPREAD:
        raise DegenerateError(
            f"expected at least {MIN_TOUCHES} touches that spread by {1e3 * MIN_SPREAD:g} mm (standard"
            f" deviation) in two directions, got {len(touches)}, spread by"
            f" {', '.join(f'{1e3 * s:.0f}' for s in spread[:2])} mm"
        )
    if not np.isfinite([touch.position for touch in touches]).all():
        raise DegenerateError("touch: expected finite positions")


def _hint(fit: BundleFit, views: list[BoardView], touches: list[TouchedPoint]) -> str:
    """What would explain the views, if something simple does."""
    if touches:
        return ""
    for factor in (0.5, 0.7, 0.9, 1.1, 1.4, 2.0):
        other = [replace(view, points=factor * view.points) for view in views]
        scaled = refine(_start(other, fit.lens), other, (), SCALE)
        if scaled.rms < min(fit.rms / 3, MAX_RMS):
            return (
                f"; a board of {factor * scaled.scale:.3f} times the size would explain them: is it this one, to scale?"
            )
    return ""


# Start


def park_martin(carriers, boards) -> tuple[np.ndarray, np.ndarray]:
    """Board on its carrier, position (3,) m and rotation (3, 3), from pairs of poses (position, rotation).

    carriers: of the carrier in the base; boards: of the board in the camera, view by view. With A =
    inverse(carrier j) carrier i and B = inverse(board j) board i, solves A Y = Y B. Needs three views that
    turn about two axes.
    """
    turns_a, turns_b, rows, rights = [], [], [], []
    for i in range(len(carriers)):
        for j in range(i):
            (pa, ra), (pb, rb) = _between(carriers[j], carriers[i]), _between(boards[j], boards[i])
            turns_a.append(vector_from_matrix(ra))
            turns_b.append(vector_from_matrix(rb))
            rows.append(ra - np.eye(3))
            rights.append((pa, pb))
    u, _, vt = np.linalg.svd(np.array(turns_a).T @ np.array(turns_b))
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    target = np.concatenate([rotation @ pb - pa for pa, pb in rights])
    return np.linalg.lstsq(np.concatenate(rows), target, rcond=None)[0], rotation


def _between(a, b):
    """Pose b in the frame of pose a."""
    return a[1].T @ (b[0] - a[0]), a[1].T @ b[1]


def _start(views: list[BoardView], lens: Lens) -> BundleFit:
    boards = [pose_in_camera(view.points, view.pixels, lens) for view in views]
    carriers = [(view.position, view.rotation) for view in views]
    rng, best = np.random.default_rng(0), None
    for _ in range(_HYPOTHESES):
        chosen = rng.choice(len(views), 3, replace=False)
        position, rotation = park_martin([carriers[i] for i in chosen], [boards[i] for i in chosen])
        i = chosen[0]
        turn = carriers[i][1] @ rotation @ boards[i][1].T
        camera = carriers[i][1] @ position + carriers[i][0] - turn @ boards[i][0]
        fit = BundleFit(camera, turn, position, rotation, lens)
        error = np.median([np.sqrt((residuals(fit, [view]) ** 2).sum(axis=1)).mean() for view in views])
        if np.isfinite(error) and (best is None or error < best[0]):
            best = error, fit
    if best is None:
        raise DegenerateError("expected views from which a camera follows, found none")
    return best[1]


def _start_from_touches(views: list[BoardView], lens: Lens, touches: list[TouchedPoint]) -> BundleFit:
    there, here = np.array([t.position for t in touches]), np.array([t.point for t in touches])
    u, _, vt = np.linalg.svd((there - there.mean(axis=0)).T @ (here - here.mean(axis=0)))
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt  # Kabsch (1976)
    position = there.mean(axis=0) - rotation @ here.mean(axis=0)
    at, turned = pose_in_camera(views[0].points, views[0].pixels, lens)
    turn = rotation @ turned.T
    return BundleFit(position - turn @ at, turn, position, rotation, lens)


# Uncertainty


def _left_out(fit: BundleFit, views, touches, value, free=POSES) -> np.ndarray:
    """`value` of the fit without each piece of evidence: a view of a moving board, or a touch; (n, ...)."""
    if touches:  # the views of a board that lies still are one
        return np.array(
            [value(refine(fit, views, [t for j, t in enumerate(touches) if j != i], free)) for i in range(len(touches))]
        )
    return np.array(
        [value(refine(fit, [v for j, v in enumerate(views) if j != i], (), free)) for i in range(len(views))]
    )


def _jackknife_covariance(values: np.ndarray) -> np.ndarray:
    difference = values - values.mean(axis=0)
    return (len(values) - 1) / len(values) * difference.T @ difference


def _jackknife(fit: BundleFit, views, touches) -> tuple[np.ndarray, float]:
    values = _left_out(
        fit,
        views,
        touches,
        lambda f: np.concatenate([f.position - fit.position, vector_from_matrix(f.rotation @ fit.rotation.T)]),
    )
    covariance = _jackknife_covariance(values)
    if touches:  # what all images of a board that lies still have in common shows in none of the fits
        most = max(views, key=lambda view: len(view.points))
        rows = linearise(fit, [most])[1].reshape(-1, 16)[:, :6]
        covariance += max(fit.rms, CORNER_SIGMA) ** 2 * np.linalg.inv(rows.T @ rows)
    return covariance, len(values) - 1.0
