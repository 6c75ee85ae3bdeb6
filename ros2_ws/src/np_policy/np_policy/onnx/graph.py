"""The graphs that are exported: from what is measured to targets in SI units. PyTorch."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from np_control.kinematics import forward_kinematics
from np_description.domains import Task
from np_policy import action, hand_pose
from np_policy.contract import POST_CONTACT, PRE_CONTACT, damping_floor, residual_limits
from np_policy.network_input import post_contact_input, pre_contact_input


class PreContactGraph(nn.Module):
    """Inputs and outputs as np_policy.onnx.signature has them, float64; `file`: the weights, as for the next class."""

    def __init__(self, network: nn.Module, domain: Task, file) -> None:
        super().__init__()
        self.network, self._domain = network, domain

    def forward(self, keypoints: Tensor, goal_keypoints: Tensor) -> tuple[Tensor, ...]:
        """Position, rotation, opening and the network's output."""
        output = _infer(self.network, pre_contact_input(self._domain, keypoints, goal_keypoints))
        return *hand_pose.decode(output), output


class PostContactGraph(nn.Module):
    """Inputs and outputs as np_policy.onnx.signature has them, float64; the contract in `file` has the residual limits."""

    def __init__(self, network: nn.Module, domain: Task, file) -> None:
        super().__init__()
        self.network, self._domain = network, domain
        self._limits, self._floor = residual_limits(file), damping_floor(file)

    def forward(self, q: Tensor, dq: Tensor, keypoints: Tensor, goal_keypoints: Tensor, last_action: Tensor):
        """Position, rotation, stiffness, damping ratio and the network's output."""
        chosen = _infer(self.network, post_contact_input(self._domain, q, dq, keypoints, goal_keypoints, last_action))
        target = action.decode(chosen, *forward_kinematics(q[..., :7]), self._limits, self._floor)
        return target.position, target.rotation, target.stiffness, target.damping_ratio, chosen


GRAPHS = {PRE_CONTACT: PreContactGraph, POST_CONTACT: PostContactGraph}


def _infer(network: nn.Module, state: Tensor) -> Tensor:
    """In float32, as in the nodes; all around it is float64."""
    return network(state.to(torch.float32)).to(torch.float64)
