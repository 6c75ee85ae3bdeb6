"""The calibration file: what is written is read, and nothing else is."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from np_common.rotations import matrix_from_vector, quaternion_from_matrix
from np_description.calibration import (
    MAX_AGE,
    Calibration,
    CalibrationError,
    CalibrationErrors,
    Lens,
    TablePlane,
    load,
    load_calibrated_camera,
    norm_bound,
)
from np_description.camera import CAMERA

NOW = datetime(2026, 11, 21, 12, 0, tzinfo=UTC)
LENS = Lens(400, 400, 741.0, 742.0, 199.0, 200.5, (0.1, -0.2, 1e-3, -2e-3, 0.05))
ERRORS = CalibrationErrors(0.001, 0.002, 0.5, 0.2, 15, 400)


def example(turn=(0.01, 0.02, -0.01), **changes) -> Calibration:
    rotation = matrix_from_vector(np.asarray(turn, float)) @ np.asarray(CAMERA.rotation)
    values = dict(
        made=NOW,
        lens=LENS,
        position=np.array([1.11, 0.01, 0.69]),
        errors=ERRORS,
        quaternion=quaternion_from_matrix(rotation),
        covariance=np.diag([1e-6] * 3 + [1e-7] * 3),
        table=TablePlane(0.001, (0.001, -0.002), (0.5, 0.0), 0.002, 0.003),
        source="bags/hand",
    )
    return Calibration(**{**values, **changes})


@settings(max_examples=30)
@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6), st.booleans())
def test_what_is_written_is_read(tmp_path_factory, numbers, has_table):
    path = tmp_path_factory.mktemp("calibration") / "camera.yaml"
    written = example(turn=np.asarray(numbers[:3]) / 2, position=numbers[3:])
    written = written if has_table else example(table=None, position=numbers[3:])
    written.save(path)
    read = load(path)
    for name in ("position", "quaternion", "covariance"):
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
    assert (read.lens, read.errors, read.table, read.made) == (written.lens, ERRORS, written.table, NOW)


def test_the_camera_to_project_with_looks_where_the_policies_learned_to_look(tmp_path):
    calibration = example()
    assert calibration.camera.rotation == CAMERA.rotation
    assert calibration.camera.position == (1.11, 0.01, 0.69)
    np.testing.assert_allclose(np.asarray(CAMERA.rotation) @ calibration.turn, calibration.rotation, atol=1e-12)
    distance, angle = calibration.displacement
    assert distance == pytest.approx(np.sqrt(3) * 0.01) and angle == pytest.approx(np.linalg.norm([0.01, 0.02, 0.01]))
    calibration.save(tmp_path / "camera.yaml")
    assert load_calibrated_camera(str(tmp_path / "camera.yaml")) == calibration.camera
    assert load_calibrated_camera("") is CAMERA


def test_age():
    calibration = example()
    assert calibration.age(NOW + timedelta(hours=3)) == timedelta(hours=3)
    assert calibration.age(NOW - timedelta(minutes=1)) == timedelta(0)
    calibration.require_fresh(now=NOW + MAX_AGE)
    with pytest.raises(CalibrationError, match="last 30 days, it is 31 days old .2026-11-21."):
        calibration.require_fresh(now=NOW + timedelta(days=31))
    with pytest.raises(CalibrationError, match="clock"):
        calibration.age(NOW - timedelta(hours=1))


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"position": [np.nan, 0, 0]}, "position: expected finite"),
        ({"quaternion": [1, 1, 0, 0]}, "norm 1"),
        ({"covariance": -np.eye(6)}, "not negative"),
        ({"covariance": np.eye(5)}, "shape"),
        ({"made": datetime(2026, 1, 1)}, "time zone"),
        ({"errors": CalibrationErrors(np.nan, 1, 1, 1, 1, 1)}, "finite"),
    ],
)
def test_what_cannot_be_is_refused(changes, words):
    with pytest.raises(CalibrationError, match=words):
        example(**changes)


@pytest.mark.parametrize(
    "spoil, words",
    [
        (lambda c: c.pop("covariance"), "expected the keys"),
        (lambda c: c.update(format=0), "expected format 1"),
        (lambda c: c.update(frame="world"), "frame panda_link0"),
        (lambda c: c.update(position=[float("nan")] * 3), "finite"),
        (lambda c: c["lens"].update(fx=-1.0), "focal length"),
        (lambda c: c["lens"].pop("fx"), "fx"),
        (lambda c: c.update(made="yesterday"), "yesterday"),
    ],
)
def test_a_spoilt_file_is_refused_by_name(tmp_path, spoil, words):
    path = tmp_path / "camera.yaml"
    example().save(path)
    content = yaml.safe_load(path.read_text())
    spoil(content)
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(CalibrationError, match=words) as raised:
        load(path)
    assert str(path) in str(raised.value)


def test_no_file_and_half_a_file_are_refused_by_name(tmp_path):
    path = tmp_path / "camera.yaml"
    with pytest.raises(CalibrationError, match="camera.yaml: expected a file written by `calibrate`"):
        load(path)
    example().save(path)
    path.write_text(path.read_text()[:300])
    with pytest.raises(CalibrationError, match="camera.yaml"):
        load(path)
    path.write_text("position: [1")
    with pytest.raises(CalibrationError, match="while parsing") as raised:
        load(path)
    assert "\n" not in str(raised.value)


def test_the_bound_of_a_length():
    assert norm_bound(np.array([[4.0]])) == pytest.approx(1.96 * 2, rel=0.02)
    assert norm_bound(np.eye(3)) == pytest.approx(2.795, rel=0.02)  # square root of chi-squared's 7.815
    assert norm_bound(np.array([[1.0]]), dof=5) == pytest.approx(2.571, rel=0.03)  # Student's t
    turn = matrix_from_vector(np.array([0.3, -0.5, 0.8]))
    covariance = np.diag([1.0, 4.0, 9.0])
    assert norm_bound(turn @ covariance @ turn.T) == pytest.approx(norm_bound(covariance))
