"""Effects of the view: harmless at zero, of the sign that they say, the same for the same image, OpenCV's where it has them."""

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real.effects import CAMERA_EFFECTS
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.catalogue import ROW
from sim2real.effects.patch import Patch, PatchEffect, dump_patch, load_patch
from sim2real.effects.sentences import ValueWithInterval, describe_effect, template_fields

from np_description.camera import CAMERA
from np_description.domains import CARD, Pose, sample_task
from np_description.keypoints import box_keypoints
from np_perception.occluded_keypoints import OccludedKeypointBuffer
from np_sim_bridge.view import SceneView

every = pytest.mark.parametrize("record", CAMERA_EFFECTS.values(), ids=list(CAMERA_EFFECTS))
HALF_SIZE = np.asarray(CARD.half_size)
PERIOD = 33_000_000  # ns
SPEED = 0.2  # m/s to the camera's right


def patch_of(effect, **parameters):
    return Patch((PatchEffect(effect, str(CAMERA_EFFECTS[effect].target), parameters),))


def resting(times):
    pose, _ = sample_task(CARD, np.random.default_rng(3))
    return np.repeat(box_keypoints(HALF_SIZE, pose.position, pose.quaternion)[None], len(times), axis=0)


def moving(times):
    """To the right in the picture."""
    return resting(times) + SPEED * np.asarray(times)[:, None, None] * np.asarray(CAMERA.rotation)[:, 0]


def truth(corners_at, time):
    return CAMERA.project(corners_at(np.array([time]))[0])[0]


def seen(view, corners_at, count=5):
    return np.array([view.keypoints(corners_at, n * PERIOD) for n in range(count)])


@every
def test_a_record_is_complete(record):
    assert set(ROW) <= set(record.entry) and record.module == record.target and record.supported_in
    assert record.detection_limit.limit > 0 and record.detection_limit.largest > 1
    for q in record.quantities:
        assert q.lower < q.upper and q.lower <= 0 <= q.upper and q.unit
    assert template_fields(record.sentence_template) == {q.name for q in record.quantities}
    assert describe_effect(
        record,
        str(record.target),
        {q.name: ValueWithInterval(0.01, 0.009, 0.011) for q in record.quantities},
        "the simulator",
    )


@every
def test_nothing_of_an_effect_does_nothing(record):
    view = CameraEffects(patch_of(record.id, **{q.name: 0.0 for q in record.quantities}))
    for n, found in enumerate(seen(view, moving)):
        assert np.allclose(found, truth(moving, n * PERIOD * 1e-9), atol=1e-9)
    assert view.oldest == 0.0


@every
def test_some_of_it_does_something_and_the_same_image_has_the_same_keypoints(record):
    patch = patch_of(record.id, **{q.name: 0.6 * q.upper for q in record.quantities})
    found, again = (seen(CameraEffects(patch, seed=5), moving, 12) for _ in range(2))
    assert np.array_equal(found, again)
    view = CameraEffects(patch, seed=5)
    assert np.array_equal(view.keypoints(moving, PERIOD), view.keypoints(moving, PERIOD))
    assert np.abs(found - [truth(moving, n * PERIOD * 1e-9) for n in range(12)]).max() > 0.1


@every
def test_a_patch_is_read_and_refused_by_component_and_range(record, tmp_path):
    path, q = tmp_path / "patch.yaml", record.quantities[0]
    path.write_text(dump_patch(patch_of(record.id, **{q.name: 0.5 * q.upper})))
    patch = load_patch(path)
    assert patch.camera == patch and not patch.arm.effects and patch.panda()
    for entry, words in (
        ({"component": "arm", "parameters": {q.name: 0.0}}, f"expected '{record.target}' as component of {record.id}"),
        (
            {"component": str(record.target), "parameters": {q.name: 2 * q.upper}},
            f"expected {q.name} of {record.id} from",
        ),
    ):
        path.write_text(yaml.safe_dump({"effects": [{"effect": record.id, **entry}]}))
        with pytest.raises(ValueError, match=words):
            load_patch(path)


def test_an_image_is_late_by_its_latency_and_its_clock():
    view = CameraEffects(patch_of("camera_latency", delay=0.05))
    assert np.allclose(view.keypoints(moving, 10 * PERIOD), truth(moving, 10 * PERIOD * 1e-9 - 0.05))
    clock = CameraEffects(patch_of("clock_offset", offset=0.02, drift=5e-4))
    assert clock.moment(100 * PERIOD) == pytest.approx(100 * PERIOD * 1e-9 * (1 - 5e-4) - 0.02)
    early = CameraEffects(patch_of("camera_latency", delay=-0.05))  # what is to come nobody can show
    assert early.moment(PERIOD) == pytest.approx(PERIOD * 1e-9)


def test_a_moved_camera_sees_the_other_way():
    pixels = CameraEffects(patch_of("camera_extrinsics", x=0.0, y=0.01, z=0.0)).keypoints(resting, 0)
    assert np.allclose(pixels, CAMERA.project(resting([0.0])[0] - [0.0, 0.01, 0.0])[0])


@settings(deadline=None, max_examples=25)
@given(st.tuples(*(st.floats(-0.3, 0.3),) * 2, *(st.floats(-0.02, 0.02),) * 2))
def test_distortion_is_opencvs(coefficients):
    k1, k2, p1, p2 = coefficients
    view = CameraEffects(patch_of("lens_distortion", k1=k1, k2=k2, p1=p1, p2=p2))
    points = resting([0.0])[0]
    rotation = np.asarray(CAMERA.rotation).T
    expected, _ = cv2.projectPoints(
        points,
        cv2.Rodrigues(rotation)[0],
        -rotation @ np.asarray(CAMERA.position),
        CAMERA.matrix,
        np.array([k1, k2, p1, p2, 0.0]),
    )
    assert np.allclose(
        view.keypoints(lambda times: np.repeat(points[None], len(times), 0), 0), expected[:, 0], atol=1e-6
    )


def test_rows_are_of_their_own_moments_and_an_exposure_is_seen_late_by_half():
    time, late = 10 * PERIOD * 1e-9, 0.04
    blurred = CameraEffects(patch_of("exposure_blur", duration=late)).keypoints(moving, 10 * PERIOD)
    assert np.allclose(blurred, truth(moving, time - late / 2), atol=0.05)
    rolled = CameraEffects(patch_of("rolling_shutter", duration=late)).keypoints(moving, 10 * PERIOD)
    share = (rolled[:, 1] - (CAMERA.height - 1) / 2) / CAMERA.height
    assert np.ptp(share) > 0.01
    for corner in range(8):
        assert np.allclose(rolled[corner], truth(moving, time + late * share[corner])[corner], atol=1e-3)


def test_repeated_images_come_as_often_as_said():
    view = CameraEffects(patch_of("frame_drop", share=0.3), seed=1)
    found = seen(view, moving, 1000)
    repeated = np.all(found[1:] == found[:-1], axis=(1, 2)).mean()
    assert 0.25 < repeated < 0.35


def test_noise_has_its_spread_and_its_memory():
    view = CameraEffects(patch_of("keypoint_noise", spread=1.5, memory=0.8), seed=2)
    error = seen(view, resting, 3000) - truth(resting, 0.0)
    assert error.std() == pytest.approx(1.5, rel=0.05)
    assert np.mean(error[1:] * error[:-1]) / error.var() == pytest.approx(0.8, abs=0.03)


def test_corners_between_two_poses_and_after_a_leap():
    corners = OccludedKeypointBuffer(HALF_SIZE, 0.1)
    poses = [Pose(np.array([0.5 + 0.01 * n, 0.0, 0.01]), np.array([1.0, 0, 0, 0])) for n in range(6)]
    for n, pose in enumerate(poses):
        corners.keep(n * PERIOD, pose)
    middle = corners.at(np.array([3.5 * PERIOD * 1e-9]))[0].mean(axis=0)
    assert np.allclose(middle, [0.535, 0.0, 0.01])
    corners.keep(6 * PERIOD, Pose(np.array([0.5, 0.5, 0.01]), np.array([1.0, 0, 0, 0])))
    assert np.allclose(corners.at(np.zeros(1))[0].mean(axis=0), [0.5, 0.5, 0.01])  # of the time before nothing is left


def test_a_picture_goes_through_the_lens_as_its_corners_do():
    patch = Patch((*patch_of("lens_distortion", k1=-0.4).effects, *patch_of("camera_intrinsics", focal=0.03).effects))
    effects = CameraEffects(patch)
    view, spot = SceneView(effects), np.array([60, 40])
    picture = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    cv2.circle(picture, spot.tolist(), 4, (255, 255, 255), -1)
    shown = view.through_lens(picture)[..., 0].astype(float)
    centre = np.array([(shown * axis).sum() / shown.sum() for axis in np.meshgrid(*map(np.arange, shown.shape))])
    assert np.allclose(centre, effects.lens(spot.astype(float)), atol=0.2)
    plain = SceneView(CameraEffects(Patch()))
    assert plain.through_lens(picture) is picture


def test_a_late_picture_is_of_the_scene_before_and_a_repeated_one_of_the_last():
    late = SceneView(CameraEffects(patch_of("camera_latency", delay=0.01)))
    for n in range(20):
        late.keep(2_000_000 * n, lambda n=n: np.array([n]))
    assert late.scene(2_000_000 * 19, lambda: None) == [14]
    late.begin()
    late.keep(40_000_000, lambda: np.array([99]))
    assert late.scene(40_000_000, lambda: None) == [99]  # nothing is known of before
    repeating = SceneView(CameraEffects(patch_of("frame_drop", share=0.9), seed=3))
    shown = []
    for n in range(60):
        repeating.keep(PERIOD * n, lambda n=n: np.array([n]))
        shown.append(int(repeating.scene(PERIOD * n, lambda: None)[0]))
    assert shown[0] == 0 and shown == sorted(shown) and 2 < len(set(shown)) < 30
    assert SceneView(CameraEffects(Patch())).scene(0, lambda: "now") == "now"
