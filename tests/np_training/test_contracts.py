"""The command that adds contracts to weights of before, and what the training writes into them."""

from dataclasses import replace

import onnx
import pytest
import torch
from detector_weights import write_detector
from safetensors.torch import save_file

from np_description.contact.model import SOFT
from np_description.domains import BUMP, CARD
from np_description.weights.contract import KEY
from np_description.weights.header import read_metadata, tensors_sha256, with_metadata
from np_description.weights.released import WeightsError, sha256
from np_perception.detector import KeypointDetector
from np_policy.contract import POST_CONTACT, PRE_CONTACT, PolicyContract
from np_policy.networks import PostContactNetwork
from np_policy.policy import PostContactPolicy
from np_training import contracts
from np_training.contracts import add_contract, make_trained_contract
from np_training.physics.config import PhysicsConfig


def test_a_contract_is_added_once_beside_the_tensors_as_they_were(tmp_path, monkeypatch, capsys):
    path = tmp_path / "post_contact_bump.safetensors"
    torch.manual_seed(0)
    save_file(PostContactNetwork().state_dict(), path, metadata={"domain": "bump", "date": "before"})
    before, tensors = sha256(path), tensors_sha256(path)
    path.with_suffix(".md").write_text(f"# Card\n\nfile, sha256 `{before}`\n")
    for said in ("contract added", "has a contract, left alone"):
        monkeypatch.setattr("sys.argv", ["contracts", str(path)])
        contracts.main()
        assert said in capsys.readouterr().out
    assert tensors_sha256(path) == tensors and sha256(path) != before
    assert read_metadata(path).keys() == {"domain", "date", KEY}
    assert PostContactPolicy(path, BUMP).warnings == []
    card = path.with_suffix(".md").read_text()
    assert f"file, sha256 `{sha256(path)}`" in card and card.count(before) == 1 and card.count(tensors) == 1


def test_an_exported_detector_goes_with_its_weights(tmp_path):
    network = write_detector(tmp_path)
    path = network.with_suffix(".safetensors")
    path.write_bytes(with_metadata(path.read_bytes(), {k: v for k, v in read_metadata(path).items() if k != KEY}))
    model = onnx.load(network)
    graph = model.graph.SerializeToString(deterministic=True)
    onnx.helper.set_model_props(model, {"domain": "card", "weights_sha256": sha256(path)})
    onnx.save(model, network)
    with pytest.raises(WeightsError, match="got none.*keypoint_detector_card.safetensors` adds one"):
        KeypointDetector(CARD, tmp_path)
    assert add_contract(path)
    assert KeypointDetector(CARD, tmp_path).information["weights_sha256"] == sha256(path)
    assert onnx.load(network).graph.SerializeToString(deterministic=True) == graph


def test_weights_that_do_not_say_what_they_are_get_none(tmp_path):
    path = tmp_path / "student.safetensors"
    save_file({"x": torch.zeros(2)}, path)
    content = path.read_bytes()
    with pytest.raises(
        WeightsError, match="a name that begins with pre_contact or post_contact and metadata with the domain"
    ):
        add_contract(path)
    assert path.read_bytes() == content


def test_the_training_writes_contracts_that_the_nodes_accept_and_what_only_it_knows():
    trained = make_trained_contract(PRE_CONTACT, BUMP, damping_floor=1.0)
    assert PolicyContract.of(PRE_CONTACT, BUMP).compare(trained.text(), "x.safetensors") == []
    assert trained.damping_ratio_range == (1.0, 2.0)
    beyond = make_trained_contract(PRE_CONTACT, BUMP, damping_floor=0.25)
    with pytest.raises(
        WeightsError, match=r"damping_ratio_range: expected one within \[0.5, 2.0\] up to its end, got \[0.25"
    ):
        PolicyContract.of(PRE_CONTACT, BUMP).compare(beyond.text(), "x.safetensors")
    assert trained.control_rate == 250.0 and trained.target_delay == (0.005, 0.04)
    soft = make_trained_contract(PRE_CONTACT, replace(CARD, contact=SOFT))
    assert soft.control_rate == 200.0
    other = make_trained_contract(POST_CONTACT, BUMP, PhysicsConfig(substeps=10))
    with pytest.raises(WeightsError, match="policy_rate: expected 10.0, got 20.0"):
        PolicyContract.of(POST_CONTACT, BUMP).compare(other.text(), "x.safetensors")
