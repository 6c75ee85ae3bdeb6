"""Released weights of a policy as one ONNX file, with their contract, the box that it was made for, names and units."""

from __future__ import annotations

import json
import logging
import warnings
from dataclasses import asdict
from pathlib import Path

import onnx
import torch

from np_description.domains import Task
from np_description.objects.choice import DEFAULT, domain_with
from np_description.weights.contract import KEY
from np_description.weights.header import read_metadata
from np_description.weights.released import WeightsError, sha256
from np_policy import weights
from np_policy.contract import KINDS, PolicyContract
from np_policy.onnx.graph import GRAPHS
from np_policy.onnx.signature import BOX, SIGNATURE, SIGNATURES, SOURCE
from np_policy.torch_network import NETWORKS


def kind_and_domain(metadata: dict[str, str], file: Path) -> tuple[str, Task]:
    """Which of KINDS a policy's file is, and its domain with the object it was trained with. Raises WeightsError."""
    contract = json.loads(metadata.get(KEY, "{}"))
    if contract.get("kind") not in KINDS:
        raise WeightsError(
            f"policy: {file}: expected a contract of one of {', '.join(KINDS)}, got {contract.get('kind')}"
        )
    return contract["kind"], domain_with(contract["domain"], metadata.get("object", DEFAULT))


def export(file: Path, folder: Path | None = None) -> Path:
    """Write `file` (.safetensors) as .onnx into `folder`, default its own; the path. Raises WeightsError."""
    metadata = read_metadata(file)
    kind, domain = kind_and_domain(metadata, file)
    network = weights.load(NETWORKS[kind](), file, PolicyContract.of(kind, domain))
    graph, signature = GRAPHS[kind](network, domain, file).eval(), SIGNATURES[kind]
    example = tuple(torch.rand(1, *shape, dtype=torch.float64) for shape, _ in signature.inputs.values())
    with torch.no_grad():
        graph(*example)  # fills the caches of constants, which must not hold the exporter's stand-ins
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter, about its own parts
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)
        model = torch.onnx.export(
            graph,
            example,
            dynamo=True,
            verbose=False,
            input_names=list(signature.inputs),
            output_names=list(signature.outputs),
        ).model_proto
    for node in model.graph.node:  # the exporter notes source lines there
        del node.metadata_props[:]
        node.doc_string = ""
    added = {BOX: json.dumps(domain.half_size), SIGNATURE: json.dumps(asdict(signature)), SOURCE: sha256(file)}
    onnx.helper.set_model_props(model, {**metadata, **added})
    target = (folder or file.parent) / file.with_suffix(".onnx").name
    target.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, target)
    return target
