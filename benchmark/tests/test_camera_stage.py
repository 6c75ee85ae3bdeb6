"""The view stage: what is off is found again and within its interval, what cannot be distinguished is not, and nothing is named where nothing is."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from bags import record_episode
from sim2real.cli import diagnose_task as command
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.patch import load_patch
from sim2real.recordings.reading import ContractViolation
from sim2real.report.camera_sentences import document
from sim2real.task.camera.diagnosis import diagnose_camera
from sim2real.task.camera.fit import Prior, _Search, evaluate_at
from sim2real.task.camera.flat_pose import fit_flat_pose
from sim2real.task.camera.model import linearise, make_scene
from sim2real.task.camera.parameters import COUNT, EFFECTS, GAP, NAMES, USUAL
from sim2real.task.camera.rest_poses import RestPose, read_rest_poses

from np_blind.camera.boxes import DEGREE, CameraCase, Detector, Truth, pixels, places, usual
from np_description.camera import CAMERA
from np_description.domains import BUMP, CARD, WALL, Pose, sample_pose
from np_description.keypoints import box_keypoints

EXACT = Detector(own=0.0, shared=0.0, gross=(0.0, 0.0), scatter=0.0, measured=(0.0, 0.0))
UNMEASURED = Detector(measured=None)
EVERYTHING = Truth(
    (0.01, 0.02, -0.01), (0.02, 0.01, -0.03), 0.02, (1, -2), 0.1, 0.005, (0.01, -0.008), (0.001, 0.002, 0.0015)
)
GAPS = {
    "camera_place": Truth(camera=(0.012, -0.010, 0.008)),
    "camera_turn": Truth(turn=(0.6 * DEGREE, -0.8 * DEGREE, 1.0 * DEGREE)),
    "focal_length": Truth(focal=0.025),
    "image_offset": Truth(offset=(4.0, -2.5)),
    "distortion": Truth(k1=0.35),
    "table_height": Truth(height=0.006),
    "table_tilt": Truth(tilt=(0.5 * DEGREE, -0.4 * DEGREE)),
    "object_size": Truth(size=(0.006, -0.004, 0.004)),
}
SECONDS_PERIODS = 4000  # of a bag with 50 images at rest


def seen_in(made):
    """Scene and first poses of places."""
    ways = [fit_flat_pose(place, CAMERA) for place in made]
    return make_scene(made, [(w.face, w.surface) for w in ways], CAMERA), np.array([w.pose for w in ways])


@pytest.mark.parametrize("domain", [CARD, BUMP], ids=lambda d: d.name)
def test_the_model_is_that_of_a_camera_written_apart(domain):
    made = places(CameraCase(EVERYTHING, EXACT, domain, 6), np.random.default_rng(3))
    seen, start = seen_in(made)
    found = evaluate_at(seen, EVERYTHING.numbers, start, 0.1)
    assert np.abs(found.left(seen)).max() < 1e-9
    assert np.abs(found.lines.off).max() < 1e-9


def test_derivatives_are_those_of_differences():
    seen, poses = seen_in(places(CameraCase(EVERYTHING, Detector(), BUMP, 5), np.random.default_rng(4)))
    vector, step = EVERYTHING.numbers, 1e-6
    lines = linearise(seen, vector, poses)

    def slope(name, by_vector, by_pose):
        ahead, behind = (linearise(seen, vector + s * by_vector, poses + s * by_pose) for s in (step, -step))
        return (getattr(ahead, name) - getattr(behind, name)) / (2 * step)

    for n, one in enumerate(np.eye(COUNT)):
        assert np.allclose(slope("pixels", one, 0), lines.by_vector[..., n], atol=1e-4)
        # Of a turn beside the measured one the derivative is that of turns that are equal: noise is .15 degrees here.
        assert np.allclose(slope("off", one, 0), lines.off_by_vector[..., n], atol=5e-3)
    for n, one in enumerate(np.eye(3)):
        assert np.allclose(slope("pixels", 0, one), lines.by_pose[..., n], atol=1e-4)
        assert np.allclose(slope("off", 0, one), lines.off_by_pose[..., n], atol=2e-2)


def test_poses_that_are_eliminated_leave_the_same_step_and_covariance():
    seen, poses = seen_in(places(CameraCase(Truth(), Detector(), CARD, 4), np.random.default_rng(5)))
    search, d = _Search(seen, Prior(np.hypot(USUAL, GAP), np.arange(COUNT) % 2 == 0, np.ones(COUNT, bool))), COUNT
    lines = linearise(seen, np.zeros(d), poses)
    weights = search.weights(lines, 0.5, 4.0)
    normal, cross, own = search.matrices(lines, np.zeros(d), weights)
    whole = np.zeros((d + 3 * len(seen),) * 2)
    whole[:d, :d] = normal
    for n in range(len(seen)):
        rows = slice(d + 3 * n, d + 3 * n + 3)
        whole[:d, rows], whole[rows, :d], whole[rows, rows] = cross[n], cross[n].T, own[n]
    down, down_own = search.slopes(lines, np.zeros(d), weights)
    step, step_own = search.solve(normal, cross, own, down, down_own, 0.0)
    scale = 1 / np.sqrt(np.diag(whole))
    dense = scale * np.linalg.solve(whole * np.outer(scale, scale), scale * np.r_[down, down_own.ravel()])
    assert np.allclose(np.r_[step, step_own.ravel()], dense, rtol=1e-6, atol=1e-10)
    covariance, _, volume = search.inverse(lines, np.zeros(d), weights)
    inverse = np.linalg.inv(whole * np.outer(scale, scale)) * np.outer(scale, scale)
    assert np.allclose(covariance, inverse[:d, :d], rtol=1e-6, atol=1e-12)
    assert volume == pytest.approx(np.linalg.slogdet(whole)[1])


@pytest.mark.parametrize("domain", [CARD, BUMP, WALL], ids=lambda d: d.name)
def test_how_it_lies_is_told_from_its_corners(domain):
    rng = np.random.default_rng(6)
    for region in (domain.start, *domain.goals):
        for _ in range(4):
            pose = sample_pose(domain, region, rng)
            corners = box_keypoints(np.asarray(domain.half_size), pose.position, pose.quaternion)
            truth = Truth(turn=(0.01, -0.02, 0.01), camera=(0.01, 0.01, -0.01))
            place = RestPose("here", pixels(truth, corners), np.full(8, 0.1), domain)
            way = fit_flat_pose(place, CAMERA)
            assert way.is_flat and way.surface == pytest.approx(region.surface)
            assert np.allclose(way.pose[:2], pose.position[:2], atol=0.08)


# Each with either object: what they show depends on the effect and on the object, flat or high.
@pytest.mark.parametrize(("effect", "domain"), [*zip(GAPS, [CARD, BUMP] * 4)])
def test_what_is_off_is_found_within_its_interval(effect, domain):
    rng = np.random.default_rng([7, list(GAPS).index(effect), domain is CARD])
    truth = GAPS[effect] + usual(rng)
    found = diagnose_camera(places(CameraCase(truth, Detector(own=0.3), domain, 12), rng))
    assert found.verdict in ("identified", "ambiguous"), found.abstention_reason
    ways = {way.name: way.estimates for one in found.findings for way in one.hypotheses}
    assert effect in ways
    values = dict(zip(NAMES, truth.numbers))
    held = [value.low <= values[name] <= value.high for name, value in ways[effect].items()]
    assert np.mean(held) > 0.6
    assert found.held_out.after < found.held_out.before and found.held_out.gain > 0


@pytest.mark.parametrize("detector", [Detector(), UNMEASURED], ids=["measured", "unmeasured"])
def test_where_nothing_is_off_nothing_is_named(detector):
    for seed in range(4):  # np_blind.camera.views counts over many
        rng = np.random.default_rng([8, seed])
        found = diagnose_camera(places(CameraCase(usual(rng), detector, (CARD, BUMP)[seed % 2], 8), rng))
        assert found.verdict in ("no_gap", "undetermined") and not found.findings
        assert found.verdict == "no_gap" or detector is UNMEASURED


def test_the_centre_of_the_image_and_a_bias_of_corners_are_one():
    rng = np.random.default_rng(9)
    found = diagnose_camera(places(CameraCase(GAPS["image_offset"] + usual(rng), Detector(), CARD, 12), rng))
    assert any("image_offset" in {one.name for one in finding.hypotheses} for finding in found.findings)
    assert set(EFFECTS["image_offset"].ids) == {"camera_intrinsics", "keypoint_bias"}
    assert found.verdict == "ambiguous" and any(
        "marked by hand" in text for row in document(found)["named"] for text in row["split_by"]
    )
    assert not [e for e in document(found)["effects"] if e["effect"] == "keypoint_bias"]


@pytest.mark.parametrize(
    ("truth", "members", "experiment"),
    [
        (Truth(height=0.05), {"table_height", "camera_place"}, "touch"),
        (Truth(camera=(0.0, 0.0, -0.05)), {"table_height", "camera_place"}, "touch"),
        (Truth(tilt=(0.03, 0.0)), {"table_tilt", "camera_turn"}, "touch"),
        (Truth(turn=(0.04, 0.0, 0.0)), {"table_tilt", "camera_turn"}, "touch"),
    ],
    ids=["height", "camera's height", "tilt", "camera's turn"],
)
def test_without_a_measured_pose_table_and_camera_are_a_class(truth, members, experiment):
    """A lower camera gives the same image as a higher table: the object's pose was not given."""
    sharp = replace(UNMEASURED, own=0.15, shared=0.05)
    found = diagnose_camera(places(CameraCase(truth, sharp, BUMP, 14), np.random.default_rng(10)))
    assert found.verdict == "ambiguous", found.abstention_reason
    classes = [{way.name for way in one.hypotheses} for one in found.findings]
    assert any(members <= one for one in classes), classes
    assert any(experiment in text for one in document(found)["named"] for text in one["split_by"])


def test_with_a_measured_pose_the_table_is_no_longer_the_camera():
    found = diagnose_camera(places(CameraCase(Truth(height=0.006), Detector(), BUMP, 12), np.random.default_rng(11)))
    assert found.verdict == "identified" and [one.hypotheses[0].name for one in found.findings] == ["table_height"]
    size = found.findings[0].hypotheses[0].estimates["table_height"]
    assert size.low < 0.006 < size.high and size.high - size.low < 0.002


@pytest.mark.parametrize("detector", [Detector(), UNMEASURED], ids=["measured", "unmeasured"])
def test_too_few_places_tell_nothing_and_say_what_is_missing(detector):
    made = places(CameraCase(GAPS["camera_turn"], detector, CARD, 8), np.random.default_rng(12))
    near = [replace(made[0], pixels=made[0].pixels + 3.0 * n) for n in range(4)]
    for few, count in ((made[:1], 1), (made[:2], 2), ([made[0]] * 5, 1), (near, 4)):
        found = document(diagnose_camera(few))
        assert found["places"] == count
        assert found["verdict"] == "undetermined" and found["unseen"] == list(NAMES)
        assert not (found["named"] or found["effects"] or found["bounds"])
        assert "are needed" in found["doubt"] and any("eight places" in step for step in found["next"])


@pytest.mark.parametrize(
    ("case", "words"),
    [
        (CameraCase(dent=0.012, domain=BUMP, count=12), "corner 3 is not where"),
        (CameraCase(moved=(5, Truth(turn=(1.0 * DEGREE, 1.0 * DEGREE, 0.0))), count=10), "was moved"),
        (CameraCase(detector=Detector(own=3.5), count=10), "px from view to view"),
    ],
    ids=["dented", "moved", "wild"],
)
def test_what_it_has_no_word_for_is_unexplained(case, words):
    found = diagnose_camera(places(case, np.random.default_rng(13)))
    assert found.verdict == "unexplained" and words in found.abstention_reason
    assert document(found)["effects"] == []


def test_places_where_it_does_not_lie_flat_are_left_out():
    made = places(CameraCase(count=8), np.random.default_rng(14))
    names = [place.name for place in made]
    swapped = replace(made[2], pixels=made[2].pixels[[3, 0, 7, 1, 5, 2, 4, 6]], position=None, rotation=None)
    lifted = replace(made[4], position=made[4].position + [0, 0, 0.2])
    found = diagnose_camera([*made[:2], swapped, made[3], lifted, *made[5:]])
    assert set(found.left_out) == {names[2], names[4]} and found.places == 6
    wrong = [replace(p, pixels=p.pixels[[3, 0, 7, 1, 5, 2, 4, 6]], position=None, rotation=None) for p in made]
    assert diagnose_camera(wrong).verdict == "unexplained" and "lies flat" in diagnose_camera(wrong).abstention_reason


def test_what_is_no_place_is_refused_in_words():
    with pytest.raises(ContractViolation, match="expected places at which the object rests.*got none"):
        diagnose_camera([])
    with pytest.raises(ContractViolation, match=r"pixels \(8, 2\) and errors \(8,\).*got \(7, 2\)"):
        RestPose("short", np.zeros((7, 2)), np.zeros(8), CARD)
    with pytest.raises(ContractViolation, match="5 usable corners or more.*got 4"):
        RestPose("hidden", np.where(np.arange(8)[:, None] < 4, 100.0, np.nan) * np.ones(2), np.zeros(8), CARD)


def test_a_patch_of_what_is_found_puts_corners_where_they_are_seen(tmp_path):
    """What a bridge's view makes of the patch is what was seen: the same axes, signs and order of the lens."""
    truth = GAPS["camera_place"] + GAPS["camera_turn"]
    made = places(
        CameraCase(truth, Detector(own=0.1, shared=0.0, measured=(1e-5, 1e-5)), BUMP, 12), np.random.default_rng(15)
    )
    found = document(diagnose_camera(made))
    (tmp_path / "patch.yaml").write_text(yaml.safe_dump({"effects": found["effects"]}))
    patch = load_patch(tmp_path / "patch.yaml")
    assert [e.effect for e in patch.effects] == ["camera_extrinsics"]
    pose = sample_pose(BUMP, BUMP.start, np.random.default_rng(1))
    corners = box_keypoints(np.asarray(BUMP.half_size), pose.position, pose.quaternion)
    shown = CameraEffects(patch).keypoints(lambda times: np.repeat(corners[None], len(times), axis=0), 10**9)
    off = np.linalg.norm(shown - pixels(truth, corners), axis=1)
    assert off.max() < 0.7 and np.linalg.norm(CAMERA.project(corners)[0] - shown, axis=1).min() > 5


def test_from_bags_to_words(tmp_path, monkeypatch, capsys):
    """Episodes of a card seen by a camera that is turned; a file and a page come out. A bag of another calibration is refused."""
    import bags

    truth, bag_names = Truth(turn=(0.0, -1.2 * DEGREE, 1.0 * DEGREE)), []

    class Turned:
        width, height = CAMERA.width, CAMERA.height

        @staticmethod
        def project(corners):
            return pixels(truth, corners), np.ones(8)

    monkeypatch.setattr(bags, "CAMERA", Turned)
    monkeypatch.setattr(bags, "KEYPOINT_OFFSET", 0.0)
    for number, (x, y) in enumerate([(0.42, -0.12), (0.6, 0.12), (0.4, 0.1), (0.58, -0.1)]):
        pose = Pose(np.array([x, y, 0.0025]), np.array([1.0, 0.0, 0.0, 0.0]))
        monkeypatch.setattr(bags, "object_pose", lambda step, count, pose=pose: pose)
        bag_names.append(str(record_episode(tmp_path / f"bag_{number}", SECONDS_PERIODS)))
    assert [len(read_rest_poses(name)) for name in bag_names] == [1] * 4
    assert command.main([*bag_names, "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out.splitlines()
    found = json.loads(told[-1])["stages"]["view"]
    assert found["places"] == 4 and found["verdict"] in ("identified", "ambiguous")
    assert any("camera_turn" in (n["name"], *(r["name"] for r in n["rivals"])) for n in found["named"])
    assert "<svg" in (tmp_path / "out/task.html").read_text()
    assert command.main([bag_names[0]]) == 0
    assert "one place" in capsys.readouterr().out
    other = record_episode(tmp_path / "other", SECONDS_PERIODS, information={"calibration": "camera.yaml"})
    assert command.main([str(other)]) == 2
    assert "expected the calibration" in json.loads(capsys.readouterr().out)["error"]
    assert command.main([str(tmp_path / "nowhere")]) == 2
