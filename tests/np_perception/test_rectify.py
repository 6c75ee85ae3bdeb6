"""Rectification: a point of the world lands where the policies' camera would see it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from np_common.rotations import matrix_from_vector
from np_description.calibration import CalibrationError, Lens
from np_description.camera import CAMERA
from np_perception.camera.rectify import Rectifier, project_distorted, view_camera

D435 = Lens(1280, 720, 920.0, 921.0, 641.0, 358.0, (0.12, -0.25, 8e-4, -5e-4, 0.08))
SMALL = st.lists(st.floats(-0.05, 0.05), min_size=3, max_size=3)


def raw_pixels(points, turn, lens=D435):
    """Where a camera at CAMERA's place, turned, sees points (n, 3) m of the base frame."""
    optical = (points - CAMERA.position) @ np.asarray(CAMERA.rotation) @ turn
    return project_distorted(optical, lens)


@settings(max_examples=10)
@given(
    SMALL,
    st.lists(st.tuples(st.floats(0.35, 0.65), st.floats(-0.2, 0.2), st.floats(0, 0.1)), min_size=1, max_size=5),
)
def test_geometry(vector, points):
    points, turn = np.array(points), matrix_from_vector(np.array(vector))
    view = Rectifier(D435, CAMERA, turn)
    expected = raw_pixels(points, turn)
    np.testing.assert_allclose(view.source_pixels(CAMERA.project(points)[0]), expected, atol=1e-6)


def test_our_distortion_is_opencvs():
    rays = np.column_stack([*np.random.default_rng(0).uniform(-0.6, 0.6, (2, 50)), np.ones(50)])
    theirs = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), D435.matrix, np.array(D435.distortion))[0][:, 0]
    np.testing.assert_allclose(project_distorted(rays, D435), theirs, atol=1e-6)


@pytest.mark.parametrize("view", ["policy", "calibration"])
@pytest.mark.parametrize("vector", [(0, 0, 0), (0.03, -0.02, 0.04)])
def test_a_spot_lands_where_it_should(view, vector):
    """Blurred spots drawn in the raw image are found by their centre of mass in the view."""
    turn, camera = matrix_from_vector(np.array(vector, float)), view_camera(view)
    rectify = Rectifier(D435, camera, turn)
    for point in np.array([[0.45, -0.1, 0.0], [0.6, 0.12, 0.0], [0.5, 0.0, 0.05]]):
        ((u, v),) = raw_pixels(point[None], turn)
        grid_v, grid_u = np.mgrid[:720, :1280]
        spot = 200 * np.exp(-((grid_u - u) ** 2 + (grid_v - v) ** 2) / (2 * 6.0**2))
        image = rectify(np.repeat(spot[..., None], 3, axis=2).round().astype(np.uint8))
        weight = image[..., 0].astype(float)
        v, u = np.mgrid[: camera.height, : camera.width]
        centre = np.array([(u * weight).sum(), (v * weight).sum()]) / weight.sum()
        np.testing.assert_allclose(centre, camera.project(point)[0], atol=0.06)


def test_detail_is_averaged_and_not_sampled():
    """Stripes finer than the view's pixels come out grey: no moire that a detector could take for edges."""
    lens = replace(D435, distortion=(0.0,) * 5)
    stripes = np.zeros((720, 1280, 3), np.uint8)
    stripes[:, ::2] = 255
    view = Rectifier(lens)(stripes)
    assert np.abs(view.astype(int) - 127).max() < 45


def test_the_policies_own_images_are_left_as_they_are():
    lens = Lens(CAMERA.width, CAMERA.height, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
    image = np.random.default_rng(0).integers(0, 256, (224, 224, 3), dtype=np.uint8)
    assert Rectifier(lens)(image) is image


def test_a_view_that_the_image_does_not_cover_is_refused():
    with pytest.raises(CalibrationError, match="% of it lie outside the camera's 640 x 480"):
        Rectifier(Lens(640, 480, 920.0, 920.0, 320.0, 240.0))
    with pytest.raises(CalibrationError, match="turned by 15.0 degrees"):
        Rectifier(D435, CAMERA, matrix_from_vector(np.array([np.radians(15), 0, 0])))
    with pytest.raises(CalibrationError, match="away"):
        Rectifier(D435, CAMERA, matrix_from_vector(np.array([np.pi, 0, 0])))


def test_images_of_another_shape_are_refused():
    with pytest.raises(ValueError, match="expected .720, 1280, 3. uint8"):
        Rectifier(D435)(np.zeros((480, 640, 3), np.uint8))
