"""Which contacts the released students choose on boxes of other sizes can be reached: with the network alone, and as the node asks it.

    python tools/other_sizes.py [--tasks 1000] [--seed 0]

The last line printed is one JSON object: for each domain and factor of all edges, the share of contacts that the arm reaches without
collision, and the median distance of hand and fingers to everything, mm (np_training.environment.contact).
"""

from __future__ import annotations

import argparse
import json

import torch

from np_description.domains import BUMP, WALL, Domain
from np_description.objects.choice import domain_with
from np_policy.contract import PRE_CONTACT, PolicyContract, weights_file
from np_policy.networks import PreContactStudent
from np_policy.weights import load
from np_training.environment import contact
from np_training.ppo.distillation import Student
from np_training.tasks.poses import sample_tasks

FACTORS = (0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2)


def scaled(domain: Domain, factor: float) -> str:
    """The text of the domain's own object with all edges times `factor`, of the same density."""
    size = [round(2 * factor * half, 6) for half in domain.half_size]
    mass = round(domain.mass * factor**3, 6)
    return json.dumps({"name": "scaled", "domain": domain.name, "size": size, "mass": mass, "surface": "paper"})


def row(domain: Domain, network: PreContactStudent, factor: float, tasks: int, seed: int) -> dict[str, object]:
    """Figures of one size."""
    text = scaled(domain, factor)
    other = domain_with(domain.name, text)
    objects, goals = sample_tasks(other, tasks, torch.Generator().manual_seed(seed))
    found: dict[str, object] = {"domain": domain.name, "factor": factor}
    for name, known in (("alone", text), ("asked", "default")):  # trained for that size, as far as it is told
        with torch.no_grad():
            position, rotation, opening = Student(network, known).hand_poses(other, objects, goals)
        contacts = contact.reach(other, position, rotation, opening, objects)
        clear = contact.gripper_clearance(other, contacts.q, opening, objects)
        found[name] = {
            "reached": round(contacts.feasible.float().mean().item(), 4),
            "clear_mm": round(1e3 * clear.median().item(), 2),
        }
    return found


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rows = []
    for domain in (BUMP, WALL):
        network = load(PreContactStudent(), weights_file(PRE_CONTACT, domain), PolicyContract.of(PRE_CONTACT, domain))
        rows += [row(domain, network, factor, options.tasks, options.seed) for factor in FACTORS]
    print(json.dumps({"tasks": options.tasks, "seed": options.seed, "contacts": rows}))


if __name__ == "__main__":
    main()
