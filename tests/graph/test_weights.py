"""Weights that were trained for something else: refused by the nodes and by the command, before anything moves."""

import json
import subprocess
from dataclasses import replace

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph_tools import command, refusal
from policy_weights import write_policies

from np_description.domains import CARD
from np_description.weights.contract import KEY
from np_description.weights.header import with_metadata
from np_policy.contract import PolicyContract, weights_file
from np_policy.nodes.pre_contact_node import main
from np_ros import qos


def finished(*words):
    return subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture
def weights(tmp_path):
    return write_policies(tmp_path / "weights", CARD)


@pytest.fixture
def osc_weights(tmp_path):
    return write_policies(tmp_path / "weights", CARD, controller="osc")


def test_a_node_refuses_weights_of_another_controller(osc_weights, capfd):
    said = refusal(capfd, main, weights=osc_weights)
    assert "pre_contact_card.safetensors were trained for something else: controller: expected impedance, got osc" in (
        said
    )


def test_an_evaluation_refuses_weights_of_another_controller_before_it_starts_a_node(osc_weights, tmp_path):
    out = tmp_path / "eval"
    options = ["--weights", osc_weights, "--keypoints", "truth", "--out", out]
    result = finished(*command("np_evaluation", "evaluate"), *map(str, options))
    assert result.returncode == 1 and result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("evaluate: weights: ") and line.endswith("controller: expected impedance, got osc")
    assert not out.exists()


@pytest.mark.slow
def test_a_node_says_in_its_diagnostics_that_its_weights_know_other_contacts(weights, graph, probe):
    name = "post_contact"
    file, contract = weights_file(name, CARD, weights), PolicyContract.of(name, CARD)
    contact = json.loads(json.dumps(contract.contact)) | {"cone": "pyramidal"}
    file.write_bytes(with_metadata(file.read_bytes(), {KEY: replace(contract, contact=contact).text()}))
    probe.collect("diagnostics", DiagnosticArray, qos.EVENT)
    graph.run("np_policy", name, {"weights": str(weights)})
    said = f"{file.name}: was trained under other contacts than those of this scene: contact.cone: expected elliptic"

    def told() -> bool:
        statuses = [status for array in probe.messages["diagnostics"] for status in array.status]
        return any(s.level == DiagnosticStatus.WARN and s.message.startswith(said) for s in statuses)

    probe.wait_until(told, what="a warning")
