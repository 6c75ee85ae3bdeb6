"""Episodes of drawn tasks without a graph: `np_evaluation.in_process`. The paper's table without one: `table3 --without-graph`.

    python tools/one_process.py --domains bump --object cube.yaml --tries 24 [--alone] [--keypoints camera]

--alone: the contact is chosen as if the object had the size that the weights know. --effects: what arm, scene and view have besides.
--contact: another law of contact than the domain's own; PhysX takes no more of it than friction.
The last line printed is one JSON object.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import torch
from sim2real.effects.patch import Patch, load_patch

from np_description.contact.model import CONTACTS
from np_description.domains import DOMAINS
from np_description.objects.choice import DEFAULT, domain_with, portable
from np_evaluation.in_process import OneProcess
from np_evaluation.scoring import summary


def main() -> None:
    """Play what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--domains", nargs=1, choices=list(DOMAINS), default=["bump"])
    parser.add_argument("--object", default=DEFAULT)
    parser.add_argument("--engine", choices=("mujoco", "physx"), default="mujoco")
    parser.add_argument("--keypoints", choices=("truth", "camera"), default="truth")
    parser.add_argument("--tries", type=int, default=5, help="episodes")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--contacts", type=int, default=1)
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--contact", choices=list(CONTACTS), help="default: in which the domain's weights were trained")
    parser.add_argument("--effects", type=Path, help="patch.yaml")
    parser.add_argument("--weights", default="", help="folder of other weights")
    options = parser.parse_args()
    torch.set_num_threads(1)
    what = {name: getattr(options, name) for name in ("seed", "contacts", "alone", "weights", "keypoints")}
    patch = load_patch(options.effects) if options.effects else Patch()
    (name,) = options.domains
    text = options.object if options.object == DEFAULT else portable(name, options.object)
    domain = domain_with(name, text)
    if options.contact:
        domain = replace(domain, contact=replace(CONTACTS[options.contact], hand=domain.contact.hand))
    played = OneProcess(domain, options.engine, patch=patch, **what)
    results = [played.play(number) for number in range(options.tries)]
    what["contact"] = domain.contact.name
    print(json.dumps({"domain": name, "object": text, "engine": options.engine, **what, **summary(results)}))


if __name__ == "__main__":
    main()
