"""The sealed test's camera beside the product's own, and what it has that the product's has not."""

import numpy as np
import pytest
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.excitation.contact_suite.tip import BEYOND
from sim2real.excitation.contact_suite.tip_path import Leg, make_segment

from np_blind.camera.hand_in_view import hidden
from np_blind.camera.quirks import Quirks, draw
from np_blind.camera.simulated_camera import BREATH, DistortedCamera, UnknownCameraFaults
from np_blind.task.cases import OUT_OF_CATALOGUE
from np_blind.task.cases import draw as draw_cases
from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA
from np_description.domains import Pose
from np_description.keypoints import box_keypoints
from np_description.panda import NOMINAL

HALF = np.array([0.045, 0.03, 0.02])
PERIOD, IMAGE = 2_000_000, 17  # ns; periods between images
GAP = {"x": 0.01, "y": -0.005, "z": 0.004, "turn_x": 0.02, "turn_y": -0.01, "turn_z": 0.015}
MOVED = Patch((PatchEffect("camera_extrinsics", "camera", GAP),))
FLAT = np.array([1.0, 0.0, 0.0, 0.0])


def pose(seconds, way=(0.15, 0.0)):
    return Pose(np.array([0.4, -0.1, 0.02]) + np.array([*way, 0.0]) * seconds, FLAT)


def filmed(
    quirks=Quirks(), gap=Patch(), strange=UnknownCameraFaults(), seconds=1.5, way=(0.15, 0.0), q=NOMINAL.ready, seed=1
):
    """Stamps s (n,) and keypoints (n, 8, 3) of an object that goes at `way` m/s."""
    film, found = DistortedCamera(HALF, quirks, gap, seed, strange), []
    for k in range(round(seconds * 500)):
        found += film.look(k * PERIOD, pose(k * PERIOD * 1e-9, way), q, k % IMAGE == 0)
    stamps, seen = zip(*found)
    return np.array(stamps) * 1e-9, np.array(seen)


def seen_at(times, way=(0.15, 0.0), gap=Patch()):
    camera = CameraEffects(gap).camera
    return np.array([camera.project(box_keypoints(HALF, pose(t, way).position, FLAT))[0] for t in times])


@pytest.mark.parametrize("late", [0.0, 0.04])
def test_a_perfect_camera_shows_what_the_products_camera_shows(late):
    gap = Patch((*MOVED.effects, PatchEffect("camera_latency", "camera", {"delay": late})))
    time, seen = filmed(gap=gap)
    assert len(time) > 40 and (seen[..., 2] == 1.0).all()
    assert np.allclose(seen[3:, :, :2], seen_at(time - late, gap=MOVED)[3:], atol=1e-6)


def test_rows_are_of_different_moments_about_the_middle_one():
    time, seen = filmed(Quirks(rows=0.022))
    rows = 0.022 * (seen[3:, :, 1] - (CAMERA.height - 1) / 2) / CAMERA.height
    late = np.array([[seen_at([t + r])[0, c] for c, r in enumerate(row)] for t, row in zip(time[3:], rows)])
    assert np.allclose(seen[3:, :, :2], late, atol=0.01) and np.abs(late - seen_at(time)[3:]).max() > 0.2


def test_an_exposure_is_about_its_middle_and_smears_what_moves():
    off = [filmed(Quirks(exposure=0.016), way=way)[1][3:, :, :2] for way in ((0.15, 0.0), (0.0, 0.0))]
    time, _ = filmed()
    moving = off[0] - seen_at(time)[3 : 3 + len(off[0])]
    assert np.abs(moving.mean(axis=(0, 1))).max() < 0.03 and 0.05 < moving[..., 1].std() < 0.3
    assert np.allclose(off[1], seen_at([0.0]), atol=1e-6)


def test_stamps_jitter_about_where_they_should_be_and_never_go_back():
    time, _ = filmed(Quirks(jitter=0.0025), seconds=12)
    late = time - np.arange(len(time)) * IMAGE * PERIOD * 1e-9
    assert (np.diff(time) > 0).all() and abs(late.mean()) < 4e-4 and late.std() == pytest.approx(0.0025, rel=0.25)
    assert (late < 0).mean() > 0.55 and late.max() > 0.006


def test_a_lens_bends_most_at_the_border():
    quirks = Quirks(lens=(0.011, 0.075, 0.0012, 0.0012))
    _, seen = filmed(quirks, way=(0.0, 0.0), seconds=0.2)
    off = np.linalg.norm(seen[0, :, :2] - seen_at([0.0])[0], axis=1)
    away = np.linalg.norm(seen[0, :, :2] - [CAMERA.cx, CAMERA.cy], axis=1)
    assert 0.02 < off[away.argmax()] < 0.4 and off[away.argmax()] > off[away.argmin()]


def test_the_hand_hides_what_is_behind_it_and_not_what_is_before_it():
    position, rotation = forward_kinematics(NOMINAL.ready)
    tip, eye = position + rotation @ [0.0, 0.0, BEYOND], np.array(CAMERA.position)
    ahead = (tip - eye) / np.linalg.norm(tip - eye)
    finger = tip - rotation @ [0.0, 0.0, 0.01]
    points = np.array([finger + 0.1 * ahead, finger - 0.1 * ahead, finger + [0.0, 0.2, 0.0]])
    assert hidden(eye, points, position, rotation).tolist() == [True, False, False]
    assert not hidden(eye, tip[None] + rotation @ [0.0, 0.0, 0.02], position, rotation).any()


def test_a_hidden_corner_is_lost_or_found_beside_and_others_are_not():
    over = np.array([0.55, 0.0, 0.05])
    q = make_segment("over", over, [Leg(over + [0.0, 0.0, 0.01], 0.05)], 0.0).positions[0]
    position, rotation = forward_kinematics(q)
    finger = position + rotation @ [0.0, 0.0, BEYOND - 0.02]
    film = DistortedCamera(HALF, Quirks(lost=0.5, beneath=3.0), Patch(), 1)
    behind = Pose(finger + 0.08 * (finger - CAMERA.position) / np.linalg.norm(finger - CAMERA.position), FLAT)
    corners = box_keypoints(HALF, behind.position, FLAT)
    covered = hidden(np.array(CAMERA.position), corners, position, rotation)
    assert 2 <= covered.sum() < 8
    found = [image for k in range(5000) for image in film.look(k * PERIOD, behind, q, k % IMAGE == 0)]
    seen = np.array([image for _, image in found])
    off = np.linalg.norm(seen[..., :2] - CAMERA.project(corners)[0], axis=-1)
    assert off[:, ~covered].max() < 1e-6 and 1.0 < off[:, covered].mean() < 8.0
    lost = seen[..., 2] < 0.5
    assert not lost[:, ~covered].any() and 0.3 < lost[:, covered].mean() < 0.7


def test_an_exposure_that_hunts_makes_corners_noisy_and_dim_in_its_dark_half():
    quirks = Quirks(noise=0.1, white=0.2, exposure=0.01)
    time, seen = filmed(quirks, strange=UnknownCameraFaults(hunting=2.0, dark=5.0), way=(0.0, 0.0), seconds=16)
    dark = np.sin(np.pi * time) > 0.5
    off = seen[..., :2] - seen_at([0.0])
    assert off[dark].std() > 3 * off[np.sin(np.pi * time) < 0].std()
    assert (seen[dark, :, 2] < 0.5).mean() > 0.3 > (seen[~dark, :, 2] < 0.5).mean()


def test_a_camera_is_knocked_once_and_a_lens_breathes_about_the_middle():
    time, seen = filmed(strange=UnknownCameraFaults(knocked=0.01, at=0.8), way=(0.0, 0.0))
    off = seen[..., :2] - seen_at([0.0])
    assert np.abs(off[time < 0.79]).max() < 1e-6 and np.allclose(off[time > 0.81], [CAMERA.fx * np.tan(0.01), 0.0])
    time, seen = filmed(strange=UnknownCameraFaults(breathing=0.02), way=(0.0, 0.0), seconds=2.0)
    still, middle = seen_at([0.0])[0], np.array([CAMERA.cx, CAMERA.cy])
    largest = np.abs(time - BREATH / 4).argmin()
    assert np.allclose(seen[largest, :, :2] - middle, 1.02 * (still - middle), atol=0.02)


def test_a_detectors_noise_remembers_the_image_before():
    _, seen = filmed(Quirks(noise=0.5, memory=0.8), way=(0.0, 0.0), seconds=16)
    off = (seen[..., :2] - seen_at([0.0])).reshape(len(seen), -1)
    assert off.std() == pytest.approx(0.5, rel=0.15)
    assert np.corrcoef(off[1:].ravel(), off[:-1].ravel())[0, 1] == pytest.approx(0.8, abs=0.05)


def test_every_case_has_a_camera_of_its_own_within_the_ranges():
    cases = draw_cases(60, 3)
    quirks = [case.camera for case in cases]
    assert len(set(quirks)) == len(quirks) and quirks[5] == draw_cases(6, 3)[5].camera
    assert all(0 <= q.rows <= 0.022 and 0 <= q.jitter <= 0.0025 and 0.001 <= q.gross <= 0.007 for q in quirks)
    assert {name for case in cases for name in case.gap if case.kind == "out"} == set(OUT_OF_CATALOGUE)
    assert isinstance(draw(np.random.default_rng(0)).lens, tuple)
