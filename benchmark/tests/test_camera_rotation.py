"""A picture that is off: is the camera elsewhere, or does it look elsewhere? Corners of an object at rest decide, by cameras written separately."""

import numpy as np
import pytest
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.effects.sentences import ValueWithInterval
from sim2real.report.task_sentences import hypothesis_text
from sim2real.task.camera.flat_pose import fit_flat_pose
from sim2real.task.camera.model import make_scene
from sim2real.task.findings import hand_eye_offset_findings
from sim2real.task.hypotheses import Hypothesis, HypothesisComparison, TaskFinding
from sim2real.task.suite.camera_rotation import prefer_rotation_over_translation
from sim2real.task.suite.hand_eye_offset import HandEyeOffset

from np_blind.camera.boxes import CameraCase, Detector, Truth, places
from np_description.camera import CAMERA
from np_description.domains import BUMP

MOVED, TURNED = Truth(camera=(0.011, -0.009, 0.0)), Truth(turn=(-0.017, -0.016, 0.0))


def shown(truth, seed):
    """Scene and poses of what is seen at twelve places, and m (2,) by which that is off."""
    made = places(CameraCase(truth, Detector(measured=None), BUMP, 12), np.random.default_rng(seed))
    ways = [fit_flat_pose(place, CAMERA) for place in made]
    poses = np.array([way.pose for way in ways])
    middle = np.array([*np.median(poses[:, :2], axis=0), BUMP.half_size[2]])
    given = dict(zip("xyz", truth.camera)) | {f"turn_{axis}": angle for axis, angle in zip("xyz", truth.turn)}
    true = CameraEffects(Patch((PatchEffect("camera_extrinsics", "camera", given),))).camera
    off = CAMERA.at_height(CAMERA.rays(true.project(middle[None])[0]), middle[2])[0] - middle[:2]
    return make_scene(made, [(way.face, way.surface) for way in ways], CAMERA), poses, off


@pytest.mark.parametrize("seed", range(4))
def test_a_camera_that_is_turned_is_told_from_one_that_stands_elsewhere(seed):
    found = prefer_rotation_over_translation(*shown(TURNED, seed), 0.0)
    assert found == pytest.approx(np.array(TURNED.turn[:2]), abs=0.0015)
    assert prefer_rotation_over_translation(*shown(MOVED, seed), 0.0) is None


def test_what_corners_tell_comes_first_and_the_patch_has_it():
    off = {"x": ValueWithInterval(-0.011, -0.012, -0.010), "y": ValueWithInterval(0.010, 0.009, 0.011)}
    named = HypothesisComparison("ambiguous", (TaskFinding((Hypothesis("picture", ("picture",), off),), 9.0),), {}, ())
    met = HandEyeOffset("ambiguous", named, ())
    (place,), (turn,) = hand_eye_offset_findings(met), hand_eye_offset_findings(met, np.array([-0.017, -0.016]))
    assert place.hypotheses[0].patch == {"x": 0.011, "y": -0.010}
    assert turn.hypotheses[0].patch == {"turn_x": -0.017, "turn_y": -0.016}
    texts = [hypothesis_text(turn, way) for way in turn.hypotheses]
    assert texts[0].endswith("by the camera's turn (off the other way)") and texts[1] == "its place"
    effects = [{one for way in finding.hypotheses for one in way.effects} for finding in (turn, place)]
    assert effects[0] == effects[1]
