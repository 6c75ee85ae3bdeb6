"""The contract of weights: what does not fit is refused by name, other contacts are a warning, versions are kept."""

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from policy_weights import write_policies
from safetensors.torch import load_file, save_file

from np_common.rotations import matrix_from_vector
from np_control.impedance import DAMPING_RATIO_MAX, DAMPING_RATIO_MIN, STIFFNESS_MAX, STIFFNESS_MIN
from np_description.camera import CAMERA
from np_description.contact.definition import contact_definition
from np_description.contact.model import HARD, OBJECT_FRICTION, SOFT
from np_description.domains import BUMP, CARD, DOMAINS, Pose, find_domain
from np_description.keypoints import box_keypoints
from np_description.symmetry import canonicalize_keypoints
from np_description.weights.contract import KEY
from np_description.weights.header import read_metadata, tensors_sha256, with_metadata
from np_description.weights.released import WeightsError, sha256
from np_perception.contract import DetectorContract
from np_perception.detector import KeypointDetector
from np_perception.pose_estimation import project_keypoints
from np_policy import action, hand_pose, observation
from np_policy.contract import KINDS, POST_CONTACT, PolicyContract, check_weights, residual_limits, weights_file
from np_policy.networks import PostContactNetwork
from np_policy.policy import PostContactPolicy
from np_policy.weights import load, save

WEIGHTS = Path(__file__).resolve().parents[2] / "weights"
RELEASED = sorted(WEIGHTS.glob("*.safetensors"))
EXPECTED = PolicyContract.of(POST_CONTACT, CARD)


@pytest.fixture
def file(tmp_path):
    """Writes an untrained policy with a contract; its path."""

    def write(contract: PolicyContract) -> Path:
        torch.manual_seed(0)
        save(PostContactNetwork(), tmp_path / "post.safetensors", contract, {"date": "today"})
        return tmp_path / "post.safetensors"

    return write


def test_weights_that_fit_are_loaded_without_a_word(file):
    path = file(PolicyContract.of(POST_CONTACT, CARD, control_rate=200.0, target_delay=(0.005, 0.04)))
    assert EXPECTED.check(path) == [] and PostContactPolicy(path, CARD).warnings == []
    assert read_metadata(path).keys() == {KEY, "date"}


OTHERS = {
    "kind": "pre_contact",
    "domain": "wall",
    "observation_version": 2,
    "observation_size": 80,
    "action_version": 0,
    "action_size": 21,
    "keypoint_order": EXPECTED.keypoint_order[::-1],
    "interchangeable_faces": True,
    "camera": EXPECTED.camera | {"width": 320},
    "controller": "osc",
    "policy_rate": 20.0,
    "stiffness_range": (EXPECTED.stiffness_range[0], [600.0] * 7),
    "damping_ratio_range": (0.1, 2.0),
    "joint_limits": EXPECTED.joint_limits | {"velocity_limit": [1.0] * 7},
}


@pytest.mark.parametrize(
    "name",
    [name for name in vars(EXPECTED) if name not in ("contact", "control_rate", "target_delay", "residual_limits")],
)
def test_every_field_that_differs_is_a_refusal_that_says_what_was_expected_and_what_came(name, file):
    path = file(replace(EXPECTED, **{name: OTHERS[name]}))
    with pytest.raises(WeightsError, match=rf"{re.escape(str(path))} .*: {name}[a-z_.]*: expected .*, got ") as caught:
        load(PostContactNetwork(), path, EXPECTED)
    assert str(caught.value).count("expected") == 1


def test_all_that_differs_is_named_at_once_and_of_a_table_only_what_differs(file):
    path = file(replace(EXPECTED, controller="osc", camera=EXPECTED.camera | {"width": 320}))
    with pytest.raises(
        WeightsError, match="camera.width: expected 224, got 320; controller: expected impedance, got osc$"
    ):
        EXPECTED.check(path)


def test_other_contacts_are_a_warning_in_words_and_notes_are_none(file):
    contact = json.loads(json.dumps(EXPECTED.contact))
    contact["fingers"]["solref"], contact["cone"] = [[0.004, 1.0]], "pyramidal"
    path = file(replace(EXPECTED, contact=contact, control_rate=1000.0))
    (warning,) = PostContactPolicy(path, CARD).warnings
    for part in (
        "post.safetensors: was trained under other contacts",
        "contact.cone: expected",
        "contact.fingers.solref",
    ):
        assert part in warning
    assert "pyramidal" in warning and "surroundings" not in warning and "control_rate" not in warning


def test_a_graph_is_told_of_both_policies_at_once(tmp_path):
    write_policies(tmp_path, CARD)
    assert check_weights(CARD, tmp_path) == []
    for kind in KINDS:
        path, contract = weights_file(kind, CARD, tmp_path), PolicyContract.of(kind, CARD)
        text = replace(contract, contact=contract.contact | {"impratio": 1.0}).text()
        path.write_bytes(with_metadata(path.read_bytes(), {KEY: text}))
    warnings = check_weights(CARD, tmp_path)
    assert [line.split("_card")[0] for line in warnings] == list(KINDS)
    assert all(line.endswith("contact.impratio: expected 10.0, got 1.0") for line in warnings)


def test_weights_without_a_contract_are_refused_with_the_command_that_adds_one(tmp_path):
    path = tmp_path / "old.safetensors"
    save_file(PostContactNetwork().state_dict(), path, metadata={"domain": "card"})
    with pytest.raises(WeightsError, match=rf"got none.*np_training.contracts {re.escape(str(path))}"):
        PostContactPolicy(path, CARD)
    path.write_bytes(with_metadata(path.read_bytes(), {KEY: "impedance"}))
    with pytest.raises(WeightsError, match="expected a contract in JSON, got 'impedance'"):
        PostContactPolicy(path, CARD)
    path.write_bytes(path.read_bytes()[:20])
    with pytest.raises(WeightsError, match="expected a safetensors file"):
        PostContactPolicy(path, CARD)


def test_the_residual_limits_are_those_of_the_weights(file):
    path = file(replace(EXPECTED, residual_limits={"position": 0.05, "rotation": 0.08}))
    assert residual_limits(path) == action.ResidualLimits(0.05, 0.08)
    with pytest.raises(WeightsError, match="residual_limits: expected position m, rotation rad, got {}"):
        residual_limits(file(replace(EXPECTED, residual_limits={})))
    with pytest.raises(WeightsError, match="residual_limits: expected numbers between 0 and 1"):
        residual_limits(file(replace(EXPECTED, residual_limits={"position": 0.05, "rotation": 0.0})))


def test_a_contract_of_an_unknown_law_or_kind_is_refused():
    with pytest.raises(ValueError, match="controller: expected one of impedance, osc, got 'pd'"):
        PolicyContract.of(POST_CONTACT, CARD, "pd")
    with pytest.raises(ValueError, match="kind: expected one of pre_contact, post_contact, got 'teacher'"):
        PolicyContract.of("teacher", CARD)


def test_metadata_are_replaced_without_touching_a_tensor(tmp_path):
    path, tensors = (
        tmp_path / "a.safetensors",
        {"x": torch.arange(6.0).reshape(2, 3), "y": torch.ones(5, dtype=torch.int64)},
    )
    save_file(tensors, path, metadata={"old": "1"})
    before, content = tensors_sha256(path), path.read_bytes()
    path.write_bytes(with_metadata(content, {"b": "2", "a": "ä"}))
    assert read_metadata(path) == {"a": "ä", "b": "2"} and tensors_sha256(path) == before
    assert all(torch.equal(tensor, tensors[name]) for name, tensor in load_file(path).items())
    assert path.read_bytes() == with_metadata(content, {"a": "ä", "b": "2"})
    save_file(tensors | {"x": tensors["x"] + 1}, path)
    assert tensors_sha256(path) != before


def test_the_contact_definition_is_that_of_the_scene():
    before = contact_definition(BUMP, SOFT)
    assert contact_definition(BUMP) == contact_definition(BUMP, HARD) != before
    for partner, friction in (
        ("surroundings", SOFT.table),
        ("fingers", SOFT.finger),
        ("object", OBJECT_FRICTION),
    ):
        assert [row[0] for row in before[partner]["friction"]] == [friction]
    after = contact_definition(BUMP, replace(SOFT, table=0.7))
    assert after["surroundings"] != before["surroundings"] and after["fingers"] == before["fingers"]


# --- the released weights -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", RELEASED, ids=lambda path: path.stem)
def test_released_weights_have_a_contract_that_fits_and_the_tensors_that_their_card_names(path):
    kind = next((kind for kind in KINDS if path.stem.startswith(kind)), None)
    domain = find_domain(path.stem.rsplit("_", 1)[1])
    contract = PolicyContract.of(kind, domain) if kind else DetectorContract.of(domain)
    contract.check(path)  # raises where it does not fit
    assert json.loads(read_metadata(path)[KEY]).keys() == vars(contract).keys()
    card = path.with_suffix(".md").read_text()
    assert sha256(path) in card
    (tensors,) = re.findall(r"of its tensors alone(?: is the same:)? `([0-9a-f]{64})`", card)
    assert tensors == tensors_sha256(path)


def test_there_are_weights_of_every_kind_for_every_domain():
    assert {path.stem for path in RELEASED} == {
        f"{kind}_{name}" for kind in (*KINDS, "keypoint_detector") for name in DOMAINS
    }


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=lambda domain: domain.name)
def test_released_weights_fit_the_code_and_the_networks_are_those_beside_them(domain):
    check_weights(domain, WEIGHTS)
    assert KeypointDetector(domain, WEIGHTS).information[KEY] == DetectorContract.of(domain).text()


# --- versions -------------------------------------------------------------------------------------------------------


def digest(*arrays) -> str:
    """Hash of numbers to nine decimals."""
    numbers = np.concatenate([np.ravel(array) for array in arrays])
    return hashlib.sha256((np.round(numbers, 9) + 0.0).tobytes()).hexdigest()[:16]


def wave(*shape: int) -> np.ndarray:
    """Numbers that are the same everywhere."""
    return np.sin(1.0 + np.arange(np.prod(shape))).reshape(shape)


POSITION, ROTATION = np.array([0.5, 0.1, 0.2]), matrix_from_vector(np.array([0.3, -0.2, 0.1]))
WHY = "what the policies see or do is no longer what their version says: raise the version, then pin what it means here"


def test_the_observations_are_what_their_versions_say():
    """From pixels on, and under the names of faces that a policy of interchangeable ones sees."""
    pixels = CAMERA.normalise(112 + 100 * wave(2, 8, 2))
    post = observation.post_contact_observation(wave(9), wave(9), *pixels, POSITION, ROTATION, wave(20))
    assert (observation.POST_VERSION, digest(post)) == (1, "2cf78073e0314f43"), WHY
    student = observation.student_observation(*canonicalize_keypoints(BUMP, *pixels))
    assert (observation.STUDENT_VERSION, digest(student)) == (1, "67b014e96ca7ddef"), WHY


def test_tensors_are_observed_as_arrays_are():
    batch = np.broadcast_to(ROTATION, (2, 3, 3, 3))
    arrays = wave(2, 3, 9), wave(2, 3, 9), wave(2, 3, 8, 2), wave(2, 3, 8, 2) ** 2, wave(2, 3, 3), batch, wave(2, 3, 20)
    for observe, given in (
        (observation.post_contact_observation, arrays),
        (observation.student_observation, arrays[2:4]),
    ):
        seen = observe(*given)
        np.testing.assert_allclose(observe(*(torch.tensor(array) for array in given)), seen, rtol=0, atol=1e-12)
        assert seen.shape == (2, 3, {7: observation.POST_SIZE, 2: observation.STUDENT_SIZE}[len(given)])


def test_corners_are_seen_where_the_keypoints_of_their_pose_are():
    pose = Pose(np.array([0.5, 0.1, 0.05]), np.array([0.8, 0.0, 0.0, 0.6]))
    seen = observation.normalise_keypoints(box_keypoints(CARD.half_size, pose.position, pose.quaternion))
    pixels = project_keypoints(CARD, pose)[:, :2]
    np.testing.assert_allclose(seen, CAMERA.normalise(pixels), atol=1e-12)


def test_the_actions_are_what_their_versions_say():
    limits = action.ResidualLimits(0.02, 0.03)
    target = action.decode(1.2 * wave(20), POSITION, ROTATION, limits)
    share = np.log(target.stiffness / STIFFNESS_MIN) / np.log(STIFFNESS_MAX / STIFFNESS_MIN)
    ratio = (target.damping_ratio - DAMPING_RATIO_MIN) / (DAMPING_RATIO_MAX - DAMPING_RATIO_MIN)
    assert (action.VERSION, digest(target.position, target.rotation, share, ratio)) == (1, "6199101f075872dd"), WHY
    assert (hand_pose.VERSION, digest(*hand_pose.decode(wave(10)))) == (1, "3b72ac69ced0708a"), WHY
