"""Hand-eye calibration on synthetic corners: exact without noise, honest with it, and refused where it cannot
be told."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from np_common.rotations import matrix_from_vector, vector_from_matrix
from np_description.calibration import Lens
from np_description.camera import CAMERA
from np_perception.calibration.board import Board
from np_perception.calibration.bundle import BoardView, BundleFit, DegenerateError, TouchedPoint, apply_step, linearise
from np_perception.calibration.hand_eye import check, park_martin, solve

LENS = Lens(400, 400, 741.0, 741.0, 199.5, 199.5)
BOARD = Board()
MIDDLE = BOARD.corners.mean(axis=0)


class Setup:
    """A camera, a board on the hand, and views of it."""

    def __init__(self, seed, count=14, noise=0.05, arm=0.0, turn=0.35, board=BOARD, axis=None):
        self.rng = rng = np.random.default_rng(seed)
        self.rotation = matrix_from_vector(rng.normal(0, 0.05, 3)) @ np.asarray(CAMERA.rotation)
        self.position = np.asarray(CAMERA.position) + rng.normal(0, 0.03, 3)
        mounted, at = matrix_from_vector(rng.normal(0, 1, 3)), rng.normal(0, 0.08, 3)
        self.views = []
        while len(self.views) < count:
            centre = np.array([*rng.uniform(-0.14, 0.14, 2), rng.uniform(0.6, 0.95)])
            vector = rng.normal(0, turn, 3) if axis is None else rng.normal(0, turn) * np.asarray(axis, float)
            seen = matrix_from_vector(vector)
            points = (board.corners - board.corners.mean(axis=0)) @ seen.T + centre
            pixels = points[:, :2] / points[:, 2:] * LENS.fx + LENS.cx
            inside = ((pixels > 2) & (pixels < 397)).all(axis=1)
            if inside.sum() < 10:
                continue
            on_base = self.rotation @ seen
            hand = on_base @ mounted.T
            position = self.rotation @ (centre - seen @ board.corners.mean(axis=0)) + self.position - hand @ at
            hand = matrix_from_vector(rng.normal(0, arm, 3)) @ hand
            self.views.append(
                BoardView(
                    position + rng.normal(0, arm, 3),
                    hand,
                    BOARD.corners[inside],
                    pixels[inside] + rng.normal(0, noise, (inside.sum(), 2)),
                )
            )

    def errors(self, fit):
        """Distance m and angle rad."""
        return (
            np.linalg.norm(fit.position - self.position),
            np.linalg.norm(vector_from_matrix(fit.rotation @ self.rotation.T)),
        )


@settings(max_examples=3)
@given(st.integers(0, 10**6))
def test_without_noise_the_camera_is_found_exactly(seed):
    setup = Setup(seed, noise=0.0)
    fit = solve(setup.views, LENS)
    distance, angle = setup.errors(fit)
    assert distance < 1e-9 and angle < 1e-9 and fit.rms < 1e-6


def test_the_closed_form_is_exact_from_three_views():
    rng = np.random.default_rng(0)
    poses = [(rng.normal(0, 1, 3), matrix_from_vector(rng.normal(0, 1, 3))) for _ in range(5)]
    camera, board = poses[3], poses[4]
    boards = []
    for at, turned in poses[:3]:
        on_base = turned @ board[0] + at, turned @ board[1]
        boards.append((camera[1].T @ (on_base[0] - camera[0]), camera[1].T @ on_base[1]))
    position, rotation = park_martin(poses[:3], boards)
    np.testing.assert_allclose(position, board[0], atol=1e-9)
    np.testing.assert_allclose(rotation, board[1], atol=1e-9)


def test_derivatives():
    setup = Setup(0, count=8)
    fit = BundleFit(setup.position + 0.01, setup.rotation, np.array([0.01, 0.02, 0.1]), np.eye(3), LENS)
    jacobian = linearise(fit, setup.views)[1]
    for k in range(16):
        step = np.zeros(16)
        step[k] = 1e-6
        numeric = (
            linearise(apply_step(fit, -step), setup.views)[0] - linearise(apply_step(fit, step), setup.views)[0]
        ) / 2e-6
        np.testing.assert_allclose(jacobian[:, :, k], numeric, rtol=1e-4, atol=1e-3 * np.abs(numeric).max())


@pytest.mark.parametrize("arm", [0.0, 0.0005])
@pytest.mark.slow
def test_the_claimed_bound_holds_about_as_often_as_claimed(arm):
    """10 cameras, corners and arm with noise. Of bounds that hold 95 times in 100, three failures in ten are
    found once in 90 such tests; the seeds are fixed."""
    held = np.zeros(2)
    for seed in range(10):
        setup = Setup(seed, count=12, noise=0.1, arm=arm)
        fit = solve(setup.views, LENS)
        held += np.array(setup.errors(fit)) <= (fit.position_95, fit.rotation_95)
        assert fit.position_95 < (0.001 if not arm else 0.015)  # and it is not held by saying nothing
    assert (held >= 8).all()


def test_wrong_views_are_left_out():
    setup = Setup(3, count=14)
    wrong = [replace(view, position=view.position + [0.05, -0.08, 0.03]) for view in setup.views[:3]]
    fit = solve([*wrong, *setup.views[3:]], LENS)
    assert fit.used == tuple(range(3, 14)) and fit.left_out == 3
    assert setup.errors(fit)[0] < 0.0005


def test_lens_and_board_are_confirmed_or_doubted():
    setup = Setup(5, count=14)
    assert check(solve(setup.views, LENS), setup.views).complaints() == []
    other = replace(LENS, fx=720.0, fy=720.0)
    found = check(solve(setup.views, other), setup.views)
    assert abs(found.focal * 720 / 741 - 1) < 0.005
    assert any("focal length looks 1.029" in text for text in found.complaints())
    printed = Setup(5, count=14, board=Board(square=0.036 * 0.96, marker=0.027 * 0.96))
    found = check(solve(printed.views, LENS), printed.views)
    assert found.scale == pytest.approx(0.96, abs=0.001)
    assert any("printed to scale" in text for text in found.complaints())


def table(seed, count=8, noise=0.0003, spread=True):
    """Views of a board on the table, and touches of its corners."""
    rng, setup = np.random.default_rng(seed), Setup(seed, count=8, noise=0.05)
    turned, at = matrix_from_vector(np.array([np.pi, 0, 0.3])), np.array([0.4, 0.1, 0.001])
    points = BOARD.corners @ turned.T + at
    seen = (points - setup.position) @ setup.rotation
    pixels = seen[:, :2] / seen[:, 2:] * LENS.fx + LENS.cx
    views = [
        BoardView(np.zeros(3), np.eye(3), BOARD.corners, pixels + rng.normal(0, 0.05, pixels.shape)) for _ in range(3)
    ]
    corners = [0, 5, 18, 23, 8, 15, 2, 21][:count] if spread else range(count)
    return setup, views, [TouchedPoint(points[i] + rng.normal(0, noise, 3), BOARD.corners[i]) for i in corners]


def test_a_touched_board_on_the_table():
    held = 0
    for seed in range(6):
        setup, views, touches = table(seed)
        fit = solve(views, LENS, touches)
        distance, angle = setup.errors(fit)
        held += distance <= fit.position_95 and angle <= fit.rotation_95
        assert distance < 0.01
    assert held >= 4


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: (Setup(0, count=7).views, ()), "expected at least 8 views, got 7"),
        (lambda: ([], ()), "expected at least 8 views, got 0"),
        (lambda: (Setup(0, turn=0.02).views, ()), "expected orientations of the hand that differ"),
        (lambda: (Setup(0, axis=(0, 0, 1)).views, ()), "about two axes"),
        (lambda: (Setup(0, arm=0.1).views, ()), "expected views that one camera explains"),
        (lambda: table(0, count=5)[1:], "expected at least 6 touches"),
        (lambda: table(0, count=6, spread=False)[1:], "in two directions"),
    ],
)
def test_what_cannot_be_told_is_refused(make, words):
    views, touches = make()
    with pytest.raises(DegenerateError, match=words):
        solve(views, LENS, touches)


def test_a_board_of_another_size_is_named_as_the_reason():
    setup = Setup(0, board=Board(square=0.018, marker=0.0135), turn=0.5)
    with pytest.raises(DegenerateError, match="a board of 0.500 times the size would explain them"):
        solve(setup.views, LENS)


def test_numbers_that_are_none_are_refused():
    view = Setup(0, count=1).views[0]
    for name in ("position", "rotation", "points", "pixels"):
        with pytest.raises(DegenerateError, match=f"finite {name}"):
            replace(view, **{name: np.full_like(getattr(view, name), np.nan)})
