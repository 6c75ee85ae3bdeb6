"""The task diagnosis: latency and offsets from simulated pushes, findings that constrain one another, the report and its page."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from bags import record_episode
from sim2real.cli import diagnose_task as command
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.effects.sentences import ValueWithInterval
from sim2real.recordings.signals import Log
from sim2real.report.task_document import check_schema, document
from sim2real.report.task_page import render
from sim2real.report.task_sentences import module_text, sentence
from sim2real.task import findings as made
from sim2real.task.diagnosis import MODULES, NOT_SEEN, TaskRecordings, diagnose_task, make_patch
from sim2real.task.hypotheses import Hypothesis, HypothesisComparison, TaskFinding
from sim2real.task.keypoint_noise import KeypointNoise, visible_noise_effects
from sim2real.task.keypoint_track import KeypointTrack
from sim2real.task.object_motion.prediction import estimate_removed_share
from sim2real.task.reading import read_recordings
from sim2real.task.suite.hand_eye_offset import FaceContact
from sim2real.task.suite.hand_eye_offset import offset_from_faces as judge_meeting
from sim2real.task.suite.image_latency import latency_from_pushes as judge_lag
from sim2real.task.suite.object_pose import camera_over_table, pose_at_start
from sim2real.task.suite.pushed_object import PushedObject
from sim2real.task.suite.recording import TaskRecording, correct_encoders
from sim2real.task.surface.estimate import SurfaceContactResult

from np_common.rotations import yaw_quaternion
from np_control.dynamics import Dynamics
from np_description.camera import CAMERA
from np_description.domains import BUMP, Pose
from np_description.keypoints import box_keypoints
from np_description.panda import NOMINAL


def push(late, speed, rng, scale=0.0, noise=3e-4):
    """A tip that runs at a speed, stops within a parabola, and rests; the object with it, seen late, in a picture of another scale."""
    at = np.arange(0.0, 2.2, 0.002)
    stop, slowing = 1.0, 0.12
    ease = np.clip((at - stop) / slowing, 0.0, 1.0)
    tip = speed * np.minimum(at, stop) + speed * slowing * (ease - ease**2 / 2)
    tip -= tip[-1]
    time = np.arange(0.35, 1.9, 1 / 30) + rng.uniform(0, 0.03)
    way = (1 + scale) * np.interp(time - late, at, tip) + noise * rng.standard_normal(len(time))
    return PushedObject("push", time, way + rng.normal(0, 1e-4), at, tip)


def test_delays_are_found_whatever_the_pictures_scale():
    rng, held = np.random.default_rng(4), 0
    for _ in range(25):
        late, scale = rng.uniform(0.0, 0.08), rng.normal(0.0, 0.005)
        found = judge_lag(tuple(push(late, speed, rng, scale) for speed in (0.03, 0.06, 0.03, 0.045)))
        assert abs(found.late.value - late) < 0.008
        held += found.late.low <= late <= found.late.high
    assert held >= 22


@pytest.mark.parametrize("readout", [0.0, 0.011, 0.022])
def test_a_delay_is_that_of_the_middle_row_however_long_rows_take(readout):
    """Pushes in the upper part of the picture are seen later than stamps say, those in the lower part earlier."""
    rng, errors = np.random.default_rng(12), []
    for _ in range(12):
        late, rows = rng.uniform(0.0, 0.05), rng.uniform(-0.25, 0.15, 8)
        pushes = (replace(push(late - readout * row, 0.06, rng, noise=2e-4), row=row) for row in rows)
        found = judge_lag(tuple(pushes)).late
        errors.append(found.value - late)
        assert found.low - 5e-4 < late < found.high + 5e-4
    assert np.sqrt(np.mean(np.square(errors))) < 0.002


def test_no_delay_is_named_where_there_is_none_and_none_is_said_of_two_pushes():
    rng = np.random.default_rng(5)
    verdicts = [judge_lag(tuple(push(0.0, 0.04, rng) for _ in range(4))).verdict for _ in range(12)]
    assert verdicts == ["no_gap"] * 12
    assert judge_lag(tuple(push(0.0, 0.04, rng) for _ in range(2))).verdict == "undetermined"


def test_an_object_that_does_not_go_along_says_no_delay():
    rng = np.random.default_rng(6)
    slips = [push(0.0, 0.04, rng) for _ in range(4)]
    slips = tuple(replace(one, way=one.way + 0.004 * np.sin(9 * one.time)) for one in slips)
    assert judge_lag(slips).verdict == "undetermined"


def faces(off, out, rng, turns=(0.1, 1.7, 3.3, 4.9, 0.1)):
    normals = np.array([[np.cos(a), np.sin(a)] for a in turns])
    return tuple(FaceContact("push", n, float(-n @ off + out + 2e-4 * rng.standard_normal())) for n in normals)


@pytest.mark.parametrize("out", [0.0, 0.006])
def test_a_picture_that_is_off_is_told_from_a_finger_that_touches_farther_out(out):
    rng = np.random.default_rng(7)
    assert judge_meeting(faces(np.zeros(2), out, rng)).verdict == "no_gap"
    off = np.array([0.009, -0.006])
    (named,) = judge_meeting(faces(off, out, rng)).comparison.findings
    assert all(
        named.hypotheses[0].estimates[name].low <= true <= named.hypotheses[0].estimates[name].high
        for name, true in zip("xy", off)
    )


def test_faces_from_one_side_say_nothing_of_the_picture():
    found = judge_meeting(faces(np.array([0.009, 0.0]), 0.0, np.random.default_rng(8), (0.1, 0.15, 0.05)))
    assert found.verdict == "undetermined"


def test_faces_across_which_a_picture_is_off_do_not_say_that_it_is_not():
    across = (1.5, 1.6, 4.6, 4.75)  # faces along y: what the picture is off in x hardly shows
    found = judge_meeting(faces(np.array([0.009, 0.0]), 0.0, np.random.default_rng(8), across))
    assert found.verdict == "undetermined" and found.comparison.unidentifiable == ("x",)
    assert "in x to" in found.abstention_reason
    both = judge_meeting(faces(np.array([0.009, 0.0]), 0.0, np.random.default_rng(8), (*across, 0.1, 3.3)))
    assert both.verdict == "identified"


def test_faces_that_no_place_explains_are_unexplained():
    met = faces(np.zeros(2), 0.0, np.random.default_rng(9))
    met = (*met[:2], replace(met[2], gap=0.02), replace(met[3], gap=-0.01), replace(met[4], gap=-0.015))
    assert judge_meeting(met).verdict == "unexplained"


def felt(height):
    bounds = {"height": ValueWithInterval(height, height - 4e-4, height + 4e-4)}
    found = (TaskFinding((Hypothesis("table_height", ("table_height",), bounds),), 50.0),) if height else ()
    return SurfaceContactResult("identified" if found else "no_gap", HypothesisComparison("", found, bounds, ()), ())


def seen_either(height):
    """The camera is lower, or the table is higher."""
    table = Hypothesis(
        "table_height", ("table_height",), {"table_height": ValueWithInterval(height, height - 1e-3, height + 1e-3)}
    )
    camera = Hypothesis(
        "camera_place", ("camera_extrinsics",), {"camera_z": ValueWithInterval(-height, -height, -height)}
    )
    return TaskFinding((camera, table), 20.0, "view")


def test_the_hand_tells_a_higher_table_from_a_lower_camera():
    kept = made.resolve_conflicts([seen_either(0.008)], felt(0.0))
    assert [way.name for way in kept[0].hypotheses] == ["camera_place"] and kept[0].is_one_effect
    touched = made.contact_findings(felt(0.008), "touch")
    (one,) = made.resolve_conflicts([seen_either(0.008), *touched], felt(0.008))
    assert one.source == "touch" and one.hypotheses[0].module == "table"
    off = TaskFinding((Hypothesis("camera_turn", ("camera_extrinsics",), {}, {"turn_x": 0.01}),), 9.0, "meeting")
    assert {c.source for c in made.resolve_conflicts([seen_either(0.008), off, *touched], felt(0.008))} == {
        "touch",
        "meeting",
    }
    assert {c.source for c in made.resolve_conflicts([seen_either(0.008), off], felt(0.0))} == {
        "view"
    }  # which says more of it
    untold = made.resolve_conflicts([seen_either(0.008)], None)
    assert len(untold[0].hypotheses) == 2 and not untold[0].is_one_effect


def still(late=0):
    """Corners that rest and scatter."""
    rng, time = np.random.default_rng(3), np.arange(300) / 30
    corners = np.array([[60, 60], [90, 60], [60, 90], [90, 90], [70, 50], [100, 50], [70, 80], [100, 80]], float)
    return KeypointTrack("still", time, corners + 0.2 * rng.standard_normal((300, 8, 2)), np.ones((300, 8), bool))


def test_an_answer_says_what_was_not_seen_and_keeps_its_schema():
    found = diagnose_task(TaskRecordings((), (still(),), ()))
    assert {row.module: row.verdict for row in found.modules} == {
        **dict.fromkeys(MODULES, NOT_SEEN),
        "keypoints": "no_gap",
    }
    told = json.loads(json.dumps(document(found, ["still"])))
    check_schema(told)
    assert told["sentence"].startswith("No gap is seen: keypoints") and "camera, timing, arm" in told["sentence"]
    page = render(found, told)
    assert all(f'"module">{module}<' in page for module in MODULES) and page.count("<svg") == 1
    assert not make_patch(found).effects


def test_a_late_image_is_patched_though_its_class_is_not_split():
    found = diagnose_task(TaskRecordings((), (still(),), ()))
    rng = np.random.default_rng(2)
    lag = judge_lag(tuple(push(0.03, 0.04, rng) for _ in range(4)))
    (claim,) = made.latency_findings(lag)
    assert {way.effects[0] for way in claim.hypotheses} == {
        "camera_latency",
        "clock_offset",
    } and not claim.is_one_effect
    rows = [
        replace(row, verdict="ambiguous", findings=(claim,), share=1.0) if row.module == "timing" else row
        for row in found.modules
    ]
    whole = replace(found, modules=tuple(rows), latency=lag)
    (entry,) = make_patch(whole).effects
    assert entry.effect == "camera_latency" and entry.parameters["delay"] == pytest.approx(0.03, abs=0.006)
    assert whole.verdict == "ambiguous" and "at the timing: images show the scene" in document(whole, [])["sentence"]


def test_the_first_sentences_name_every_part_that_is_off():
    found = diagnose_task(TaskRecordings((), (still(),), ()))
    x = ValueWithInterval(-0.008, -0.0089, -0.007)
    sizes = {"x": x, "y": ValueWithInterval(0.0, -0.001, 0.001), "z": x}
    claims = {
        "camera": TaskFinding(
            (Hypothesis("camera_place", ("camera_extrinsics",), sizes, {"x": 0.008}),), 20.0, "meeting"
        ),
        "table": TaskFinding(
            (Hypothesis("table_height", ("table_height",), {"height": x}, {"height": 0.003}),), 30.0, "touch"
        ),
    }
    shares = {"table": 0.59, "camera": 0.41}
    rows = [
        replace(row, verdict="ambiguous", findings=(claims[row.module],), share=shares[row.module])
        if row.module in claims
        else row
        for row in found.modules
    ]
    said = sentence(replace(found, modules=tuple(rows)))
    assert said.startswith("Most of what is off (59 %) is at the table: ")
    assert "41 % is at the camera: the picture shows things -8.0 mm" in said and "off the other way" in said


def tall_table(nats):
    height = ValueWithInterval(0.003, 0.002, 0.004)
    return TaskFinding((Hypothesis("table_height", ("table_height",), {"height": height}),), nats, "touch")


def relative(effect, nats):
    return TaskFinding((Hypothesis(effect, (effect,), {effect: ValueWithInterval(0.3, 0.2, 0.4)}),), nats, "force")


def with_findings(findings):
    """A diagnosis in which modules have these findings."""
    found, total = (
        diagnose_task(TaskRecordings((), (still(),), ())),
        sum(f.log_bayes_factor for fs in findings.values() for f in fs),
    )
    rows = [
        replace(row, verdict="identified", findings=own, share=sum(f.log_bayes_factor for f in own) / total)
        if (own := tuple(findings.get(row.module, ())))
        else row
        for row in found.modules
    ]
    return replace(found, modules=tuple(rows))


def test_of_many_findings_three_are_named_and_the_others_counted():
    heavy, slippery = (
        [relative("object_mass", 0.2)],
        [relative("table_friction", 20.0), relative("gripper_friction", 30.0)],
    )
    said = sentence(with_findings({"table": [tall_table(60.0)], "object": heavy}))
    assert said.startswith(
        "Almost all that is off is at the table: the table is 3 mm (2 to 4) higher. Less than 1 % is at the object: "
    )
    assert "see the report's table" not in said
    whole = with_findings({"contact": slippery, "table": [tall_table(40.0)], "object": heavy})
    said = sentence(whole)
    assert said.startswith(
        "Most of what is off (55 %) is at the contact: the object has 35 % (22 to 49) more friction with a fingertip. 44 % is at"
    )
    assert "at the object: the object weighs 35 %" in said and "with the table" not in said
    assert "And 1 more at the contact, see the report's table." in said
    assert "friction with the table" in next(r["said"] for r in document(whole, [])["rows"] if r["module"] == "contact")
    rows = [
        replace(row, verdict="unexplained", abstention_reason=f"{row.module} is odd")
        if row.module in ("contact", "table")
        else row
        for row in whole.modules
    ]
    assert sentence(replace(whole, modules=tuple(rows))).startswith(
        "Something at the contact and table is off that no known effect explains: contact is odd; table is odd. Most of"
    )
    said = sentence(with_findings({"contact": slippery}))
    assert said.startswith("What is off is at the contact: ") and said.index("fingertip; ") < said.index(
        "with the table"
    )


def test_corners_that_scatter_more_are_said_with_their_size():
    found = diagnose_task(TaskRecordings((), (still(),), ()))
    share, size = ValueWithInterval(0.25, 0.22, 0.29), ValueWithInterval(0.2, 0.19, 0.22)
    assert "of corners" not in module_text(found.module("keypoints"), found)
    found = replace(found, noise=replace(found.noise, share=share, size=size))
    text = module_text(found.module("keypoints"), found)
    assert re.search(r"Scatter 0\.\d+ px .*; \d+ % .* of corners scatter more, by \d", text) and "gross" not in text


@pytest.mark.parametrize(
    "other, source, is_given",
    [("camera_extrinsics", "touch", True), ("keypoint_bias", "touch", False), ("keypoint_bias", "view", True)],
)
def test_an_effect_without_a_rival_is_patched_and_a_picture_that_is_off_by_its_likeliest(other, source, is_given):
    turn = Hypothesis("camera_turn", ("camera_extrinsics",), {}, {"turn_y": 0.015})
    claim = TaskFinding((turn, Hypothesis("other", (other,), {}, {"x": 0.01})), 9.0, source)
    found = diagnose_task(TaskRecordings((), (still(),), ()))
    rows = [
        replace(row, verdict="identified", findings=(claim,), share=1.0) if row.module == "camera" else row
        for row in found.modules
    ]
    given = {e.effect: e.parameters for e in make_patch(replace(found, modules=tuple(rows))).effects}
    assert given == ({"camera_extrinsics": {"turn_y": 0.015}} if is_given else {})


def test_a_bag_that_is_none_is_refused_by_name(tmp_path, capsys):
    assert command.main([str(tmp_path / "nothing")]) == 2
    assert "nothing" in json.loads(capsys.readouterr().out)["error"]


def test_of_a_recording_of_the_arms_suite_the_other_suite_is_named(tmp_path, capsys):
    bag = record_episode(tmp_path / "bag", 50, information={"experiments": ["sweep_7"]}, leave_out=("keypoints",))
    assert command.main([str(bag)]) == 2
    assert "expected messages on keypoints" in (said := json.loads(capsys.readouterr().out)["error"])
    assert said.endswith("; `excite --suite task` records keypoints")


def test_an_arms_report_that_is_none_is_refused_by_name(tmp_path, capsys):
    (tmp_path / "report.json").write_text("{}")
    assert command.main([str(tmp_path / "bag"), "--arm", str(tmp_path)]) == 2
    assert "report.json" in json.loads(capsys.readouterr().out)["error"]


def test_an_episode_is_seen_and_not_felt(tmp_path):
    bag = record_episode(tmp_path / "bag")
    seen = read_recordings([bag])
    assert len(seen.tracks) == 1 and not seen.tasks


@pytest.mark.parametrize("with_gravity", [False, True])
def test_a_recording_of_biased_encoders_is_corrected_to_the_true_angles_and_torques(with_gravity):
    rng, gravity = np.random.default_rng(8), Dynamics().gravity
    time, bias = np.arange(0.0, 0.02, 0.002), np.array([0.0, -0.014, 0.0, 0.01, 0.0, 0.003, 0.0])
    true = np.array([0.0, 0.3, 0.0, -2.0, 0.0, 2.3, 0.8]) + 0.1 * rng.standard_normal((len(time), 7))
    drives = np.array([gravity(q) for q in true]) + rng.standard_normal((len(time), 7))
    torque = drives if with_gravity else drives - np.array([gravity(q) for q in true + bias])
    log = Log("suite", time, true + bias, np.zeros_like(true), torque, time, with_gravity)
    recording = TaskRecording(log, still(), 0.0, BUMP, {})
    found = correct_encoders(recording, bias).log
    expected = drives if with_gravity else drives - np.array([gravity(q) for q in true])
    assert np.allclose(found.position, true)
    assert np.allclose(found.torque, expected)
    assert correct_encoders(recording, np.zeros(7)) is recording


@pytest.mark.parametrize(("spread", "named"), [(0.2, True), (0.001, False)])
def test_images_of_a_detector_without_noise_are_not_said_to_be_repeated(spread, named):
    none = ValueWithInterval(0.0, 0.0, 0.0)
    found = KeypointNoise(
        9.0, 270, ValueWithInterval(spread, spread, spread), none, none, none, ValueWithInterval(0.17, 0.16, 0.18)
    )
    assert ("frame_drop" in visible_noise_effects(found)) is named


def test_a_table_that_was_felt_lower_is_not_taken_for_a_camera():
    """An object on it is seen where it is, though 15 mm below where objects are believed to lie."""
    lain = Pose(np.array([0.5, -0.14, 0.045 - 0.015]), yaw_quaternion(np.asarray(0.3)))
    pixels = CAMERA.project(box_keypoints(np.asarray(BUMP.half_size), lain.position, lain.quaternion))[0]
    time = np.arange(30) / 30
    track = KeypointTrack("low", time, np.tile(pixels, (30, 1, 1)), np.ones((30, 8), bool))
    state = np.arange(0, 1, 0.01)
    joints = np.tile(NOMINAL.ready, (len(state), 1))
    recording = TaskRecording(
        Log("low", state, joints, 0 * joints, 0 * joints, state, False), track, 0.0, BUMP, {"push_1": (0.0, 1.0)}
    )
    seen = pose_at_start(recording, "push_1", camera_over_table(CAMERA, -0.015))
    assert seen.position == pytest.approx([0.5, -0.14, 0.045], abs=3e-4)


@pytest.mark.parametrize("hidden", [(), (4, 5), (4, 5, 6)])
def test_a_turned_camera_shows_an_object_off_by_the_same_whichever_corners_are_seen(hidden):
    """To such a camera an object that lies flat looks tilted: a free pose would be elsewhere, and only where all its corners are seen."""
    turned = Patch((PatchEffect("camera_extrinsics", "camera", {"turn_x": 0.0128, "turn_y": -0.0244}),))
    lain = Pose(np.array([0.5, -0.14, 0.045]), yaw_quaternion(np.asarray(0.3)))
    corners = box_keypoints(np.asarray(BUMP.half_size), lain.position, lain.quaternion)
    pixels = np.tile(CameraEffects(turned).camera.project(corners)[0], (30, 1, 1))
    usable = np.ones((30, 8), bool)
    usable[:, hidden] = False
    state = np.arange(0, 1, 0.01)
    joints = np.tile(NOMINAL.ready, (len(state), 1))
    log = Log("turned", state, joints, 0 * joints, 0 * joints, state, False)
    seen = pose_at_start(
        TaskRecording(
            log, KeypointTrack("turned", np.arange(30) / 30, pixels, usable), 0.0, BUMP, {"push_1": (0.0, 1.0)}
        ),
        "push_1",
    )
    shown = CAMERA.at_height(CAMERA.rays(CameraEffects(turned).camera.project(lain.position[None])[0]), 0.045)[0]
    assert seen.position[2] == pytest.approx(0.045, abs=1e-6) and seen.position[:2] == pytest.approx(shown, abs=0.003)


def test_the_interval_of_a_share_knows_of_windows_that_differ():
    alike = estimate_removed_share(np.full(12, 2.0), np.full(12, 1.0))
    assert alike.value == alike.low == alike.high == 0.5
    wide = estimate_removed_share(np.full(12, 2.0), np.r_[np.zeros(6), np.full(6, 2.0)])
    assert wide.value == 0.5 and wide.low < 0.3 and wide.high > 0.7
