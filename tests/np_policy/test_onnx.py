"""A policy as one ONNX file: the same answers as with PyTorch, a contract, names with units, clear refusals."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import onnx
import pytest
from policy_weights import write_policies

from np_description.domains import BUMP, sample_task
from np_description.panda import NOMINAL
from np_perception.pose_estimation import project_keypoints
from np_policy.contract import KINDS, POST_CONTACT, PRE_CONTACT, check_weights, weights_file
from np_policy.onnx.export import export
from np_policy.onnx.parity import check_parity
from np_policy.onnx.signature import SIGNATURE, SIGNATURES
from np_policy.policy import PostContactPolicy, PreContactPolicy
from np_policy.weights import WeightsError, sha256

START, GOAL = (project_keypoints(BUMP, pose) for pose in sample_task(BUMP, np.random.default_rng(0)))
Q, DQ = np.concatenate([NOMINAL.ready, [0.01, 0.01]]), np.linspace(-0.2, 0.2, 9)


@pytest.fixture(scope="module")
def released(tmp_path_factory):
    """Random policies of the bump, whose keypoints are reordered."""
    return write_policies(tmp_path_factory.mktemp("released"), BUMP)


@pytest.fixture(scope="module")
def exported(released, tmp_path_factory):
    """A folder with nothing but the .onnx."""
    folder = tmp_path_factory.mktemp("exported")
    for kind in KINDS:
        export(weights_file(kind, BUMP, released), folder)
    return folder


@pytest.mark.parametrize("kind", KINDS)
def test_the_graph_answers_as_pytorch(released, exported, kind):
    found = check_parity(weights_file(kind, BUMP, exported), weights_file(kind, BUMP, released), steps=50)
    assert found["parity"] and found["difference"].keys() == SIGNATURES[kind].outputs.keys()


def test_an_episode_with_memory_goes_as_with_pytorch(released, exported):
    a, b = (PostContactPolicy(weights_file(POST_CONTACT, BUMP, folder), BUMP) for folder in (released, exported))
    for keypoints in (START, START, None, GOAL):
        expected, found = (policy.act(Q, DQ, keypoints, GOAL) for policy in (a, b))
        np.testing.assert_allclose(found.position, expected.position, atol=1e-6)
        np.testing.assert_allclose(found.stiffness, expected.stiffness, rtol=1e-5)
    chosen = [
        PreContactPolicy(weights_file(PRE_CONTACT, BUMP, f), BUMP).propose(START, GOAL) for f in (released, exported)
    ]
    np.testing.assert_allclose(chosen[1].pose.position, chosen[0].pose.position, atol=1e-6)


def test_the_file_names_its_weights_and_units(released, exported):
    file = weights_file(POST_CONTACT, BUMP, exported)
    assert file.suffix == ".onnx" and check_weights(BUMP, exported) == []
    metadata = {each.key: each.value for each in onnx.load(file).metadata_props}
    assert metadata["weights_sha256"] == sha256(weights_file(POST_CONTACT, BUMP, released))
    assert json.loads(metadata[SIGNATURE])["outputs"]["stiffness"] == [[7], "Nm/rad"]


def test_the_nodes_policies_do_without_pytorch(exported):
    code = (
        "import sys; from np_description.domains import BUMP; from np_policy.policy import PostContactPolicy;"
        f"PostContactPolicy({str(weights_file(POST_CONTACT, BUMP, exported))!r}, BUMP); sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_what_does_not_fit_is_refused(exported, tmp_path):
    file = weights_file(POST_CONTACT, BUMP, exported)
    with pytest.raises(WeightsError, match="kind: expected pre_contact, got post_contact"):
        PreContactPolicy(file, BUMP)
    with pytest.raises(WeightsError, match="exported for a box of half sizes"):
        PostContactPolicy(file, replace(BUMP, half_size=(0.02, 0.02, 0.02)))
    with pytest.raises(WeightsError, match="other sha256"):
        other = write_policies(tmp_path, BUMP, opening=0.02)
        check_parity(weights_file(PRE_CONTACT, BUMP, exported), weights_file(PRE_CONTACT, BUMP, other))
    with pytest.raises(WeightsError, match="does not exist"):
        PostContactPolicy(tmp_path / "none.onnx", BUMP)
    (tmp_path / "broken.onnx").write_bytes(b"no network")
    with pytest.raises(WeightsError, match="cannot be read"):
        PostContactPolicy(tmp_path / "broken.onnx", BUMP)
