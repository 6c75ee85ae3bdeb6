"""Networks for tests: right shapes and file names, random or with a chosen output, nothing learnt."""

from pathlib import Path

import numpy as np
import torch
from np_description.domains import Domain
from np_description.panda import FINGER_MAX
from np_description.rotations import six_from_matrix
from np_policy.networks import TCP_CENTRE, TCP_RANGE, PostContactPolicy, PreContactStudent
from np_policy.policy import weights_file
from np_policy.weights import save


def write_policies(folder: Path, domain: Domain, *, position=(0.5, 0.0, 0.06), opening: float = 0.01) -> Path:
    """A student that always wants the hand at `position`, pointing down, and a random post-contact policy; the folder."""
    torch.manual_seed(0)
    student, policy = PreContactStudent(), PostContactPolicy()
    wanted = np.concatenate([six_from_matrix(np.diag([1.0, -1.0, -1.0])),
                             (np.array(position) - TCP_CENTRE) / TCP_RANGE, [opening / FINGER_MAX]])
    with torch.no_grad():
        student.net[-1].weight.zero_()
        student.net[-1].bias.copy_(torch.from_numpy(wanted))
        policy.net[-1].weight.normal_(std=0.1)
    folder.mkdir(parents=True, exist_ok=True)
    save(student, weights_file("pre_contact", domain, folder))
    save(policy, weights_file("post_contact", domain, folder))
    return folder
