"""The task set: its key, how reports are judged, and recordings of its simulated reality."""

import json
from functools import partial

import numpy as np
import pytest
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.task.diagnosis import TaskRecordings, diagnose_task
from sim2real.task.keypoint_track import KeypointTrack
from sim2real.task.object_motion.prediction import predict_motion
from sim2real.task.suite.image_latency import estimate_image_latency

from np_blind.task.cases import GAPS, ORDER, draw, make_key
from np_blind.task.evaluation import score_diagnosis
from np_blind.task.figures import figures
from np_blind.task.simulated_lab import SimulatedLab
from np_description.contact.model import STEADY
from np_description.domains import BUMP
from np_description.mujoco_engine import MujocoEngine


def still(late=0):
    """Corners that rest and scatter."""
    rng, time = np.random.default_rng(3), np.arange(300) / 30
    corners = np.array([[60, 60], [90, 60], [60, 90], [90, 90], [70, 50], [100, 50], [70, 80], [100, 80]], float)
    return KeypointTrack("still", time, corners + 0.2 * rng.standard_normal((300, 8, 2)), np.ones((300, 8), bool))


def test_a_key_of_the_blind_set_is_of_its_seed_alone_and_has_all_kinds():
    assert make_key(16, 5) == make_key(16, 5) != make_key(16, 6)
    assert json.loads(make_key(3, 5))["cases"] == json.loads(make_key(16, 5))["cases"][:3]
    assert {name for names in ORDER for name in names.split()} == set(GAPS)
    cases = draw(len(ORDER), 5)
    assert {case.kind for case in cases} == {"clean", "single", "pair", "out"}
    for case in cases:
        change = case.patch.scene_change()
        assert "object_mass" not in case.gap or abs(change.mass - 1) >= 0.3
        assert (case.kind == "pair") == (len(case.effects) == 2) and (case.kind == "out") == bool(
            set(case.gap) - set(case.effects)
        )


def test_a_false_alarm_and_a_miss_are_judged_as_such():
    found = diagnose_task(TaskRecordings((), (still(),), ()))
    cases = {case.kind: case for case in draw(16, 5)}
    quiet = score_diagnosis(cases["clean"], found)
    missed = score_diagnosis(cases["single"], found)
    assert missed["module"] is False and missed["effect"] is False and quiet["module"] is None
    alarm = {**quiet, "named": [["object_mass"]]}
    broken = {"error": "died", "kind": "clean", "gap": {}}
    shares = figures([quiet, alarm, missed, broken, {**broken, "kind": "single", "gap": {"object_mass": {}}}])
    assert shares["false alarm, clean"] == {**shares["false alarm, clean"], "value": 2 / 3, "of": 3}
    assert shares["errors"]["value"] == 0.4
    assert shares["right module, singles"] == {**shares["right module, singles"], "value": 0.0, "of": 2}


def test_a_patch_that_is_right_predicts_taps_better_and_its_opposite_worse():
    aside, other = (Patch((PatchEffect("camera_extrinsics", "camera", {"x": x, "y": x}),)) for x in (0.01, -0.01))
    recording = SimulatedLab(BUMP, aside, 3, partial(MujocoEngine, contact=STEADY)).run(("tap",))
    right, wrong = predict_motion([recording], aside), predict_motion([recording], other)
    assert right.windows == 2 and right.after < 0.7 * right.before and right.removed.low > 0.3
    assert right.by_effect == {"camera_extrinsics": right.removed.value}
    assert wrong.after > wrong.before and wrong.removed.value < 0
    nothing = predict_motion([recording], Patch())
    assert nothing.before == nothing.after == right.before and not nothing.by_effect and nothing.removed.value == 0


@pytest.mark.parametrize("delay", [0.0, 0.04])
def test_shoves_tell_a_delay_within_three_milliseconds(delay):
    late = Patch((PatchEffect("camera_latency", "camera", {"delay": delay}),) if delay else ())
    found = estimate_image_latency([SimulatedLab(BUMP, late, 4, MujocoEngine).run(("shove",))])
    assert [one.name for one in found.pushes if one.name.startswith("shove")] == ["shove_1", "shove_2", "shove_3"]
    assert found.late.value == pytest.approx(delay, abs=0.003) and found.late.high - found.late.low < 0.008
