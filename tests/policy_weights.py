"""Networks for tests: right shapes and file names, random or with a chosen output, nothing learnt."""

from pathlib import Path

import numpy as np
import torch

from np_description.domains import Task
from np_policy import hand_pose
from np_policy.contract import POST_CONTACT, PRE_CONTACT, PolicyContract, weights_file
from np_policy.networks import PostContactNetwork, PreContactNetwork
from np_policy.weights import save


def write_policies(
    folder: Path,
    domain: Task,
    *,
    position=(0.5, 0.0, 0.06),
    opening: float = 0.01,
    controller: str = "impedance",
) -> Path:
    """A student that always wants the hand at `position`, pointing down, and a random post-contact policy; the folder.
    controller: what their contracts say that they were trained with."""
    torch.manual_seed(0)
    student, policy = PreContactNetwork(), PostContactNetwork()
    wanted = hand_pose.encode(np.array(position), np.diag([1.0, -1.0, -1.0]), np.array(opening))
    with torch.no_grad():
        student.net[-1].weight.zero_()
        student.net[-1].bias.copy_(torch.from_numpy(wanted))
        policy.net[-1].weight.normal_(std=0.1)
    folder.mkdir(parents=True, exist_ok=True)
    for kind, network in ((PRE_CONTACT, student), (POST_CONTACT, policy)):
        save(network, weights_file(kind, domain, folder), PolicyContract.of(kind, domain, controller))
    return folder
