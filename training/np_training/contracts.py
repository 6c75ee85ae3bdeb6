"""The contracts of trained weights, and the command that adds one to weights that were saved before there were any.

    python -m np_training.contracts weights/*.safetensors

It states that a file was trained with what the code defines today: observation, action, gains, contacts and the rest.
Tensors stay as they are, bit for bit. The model card beside the file then names the sha256 of now and that of before; an
.onnx beside a detector's weights gets the same contract, and their new sha256. A file that has a contract is left alone.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

from np_common.cli import Parser
from np_control.impedance import DAMPING_RATIO_MAX, DAMPING_RATIO_MIN
from np_description.domains import Task, find_domain
from np_description.weights.contract import KEY, Contract
from np_description.weights.header import read_metadata, tensors_sha256, with_metadata
from np_description.weights.released import WeightsError, sha256
from np_perception.contract import DetectorContract
from np_policy.contract import KINDS, PolicyContract
from np_training.physics.config import LEARNED_IN, PhysicsConfig, physics_for
from np_training.tasks.randomisation import DELAY_STEP, PAPER


def make_trained_contract(
    kind: str,
    domain: Task,
    physics: PhysicsConfig | None = None,
    damping_floor: float = DAMPING_RATIO_MIN,
) -> PolicyContract:
    """The contract of weights that the training writes now, with what only the training determines; physics: default the
    one in which the domain's policies are learned; damping_floor: least damping ratio of an action."""
    physics = physics or physics_for(LEARNED_IN[domain.contact.name])
    contract = PolicyContract.of(
        kind,
        domain,
        policy_rate=round(1 / (physics.timestep * physics.substeps), 6),
        control_rate=round(1 / physics.timestep, 6),
        target_delay=tuple(round(steps * DELAY_STEP, 6) for steps in PAPER.delay),
    )
    return replace(contract, damping_ratio_range=(damping_floor, DAMPING_RATIO_MAX))


def contract_for(path: Path) -> Contract:
    """The contract of today for weights that have none: what they are is read off their metadata and name.

    Raises WeightsError where neither states it.
    """
    metadata = read_metadata(path)
    if "training" in metadata:
        return DetectorContract.of(find_domain(json.loads(metadata["training"])["domain"]))
    kind = next((kind for kind in KINDS if path.name.startswith(kind)), None)
    if kind is None or "domain" not in metadata:
        raise WeightsError(
            f"weights: {path}: expected a detector, or a name that begins with {' or '.join(KINDS)} and metadata with the "
            f"domain, got metadata {sorted(metadata)}"
        )
    return make_trained_contract(kind, find_domain(metadata["domain"]))


def add_contract(path: Path) -> bool:
    """Add a contract to a file of weights, and see to the card and the .onnx beside it; False where it has one already.

    Raises WeightsError for a file that is missing or does not identify itself.
    """
    metadata = read_metadata(path)
    if KEY in metadata:
        return False
    before, contract = sha256(path), contract_for(path)
    path.write_bytes(with_metadata(path.read_bytes(), {**metadata, KEY: contract.text()}))
    note = (
        f"Before its contract was added its sha256 was `{before}`, by which older results name it; that of its tensors"
    )
    notes = [f"{note} alone is the same: `{tensors_sha256(path)}`."]
    if (network := path.with_suffix(".onnx")).is_file():
        notes.append(f"So with `{network.name}`: before `{sha256(network)}`, now `{_renew(network, contract, path)}`.")
    if (card := path.with_suffix(".md")).is_file():
        text = card.read_text().replace(before, sha256(path), 1)
        card.write_text("\n\n".join([text.rstrip("\n"), *notes]) + "\n")
    return True


def _renew(network: Path, contract: Contract, weights: Path) -> str:
    """Give an exported network the contract and the sha256 of the weights that it was exported from; its own sha256."""
    import onnx

    model = onnx.load(network)
    onnx.helper.set_model_props(model, {KEY: contract.text(), "weights_sha256": sha256(weights)})
    onnx.save(model, network)
    return sha256(network)


def main() -> None:
    """Add contracts; prints a line a file."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", type=Path, nargs="+", help="safetensors files")
    arguments = parser.parse_args()
    for path in arguments.weights:
        print(f"{path}: {'contract added' if add_contract(path) else 'has a contract, left alone'}")


if __name__ == "__main__":
    main()
