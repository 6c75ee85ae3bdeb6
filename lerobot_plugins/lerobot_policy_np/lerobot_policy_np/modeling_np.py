"""The post-contact policy with its memory, as LeRobot calls it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_STATE
from torch import Tensor

from np_common.rotations import quaternion_from_matrix
from np_description.domains import find_domain
from np_policy.policy import PostContactPolicy

from .configuration_np import NpConfig


class NpPolicy(PreTrainedPolicy):
    """Observation of robot `np_franka` with its goal, one sample, to the action of its command `pose`."""

    config_class = NpConfig
    name = "np"

    def __init__(self, config: NpConfig, **_) -> None:
        super().__init__(config)
        config.validate_features()
        self._policy = PostContactPolicy(config.file, find_domain(config.domain))

    @classmethod
    def from_pretrained(
        cls, pretrained_name_or_path: str | Path, *, config: NpConfig | None = None, **options
    ) -> NpPolicy:
        """From a folder with config.json; the network is the file that it names."""
        return cls(config or NpConfig.from_pretrained(pretrained_name_or_path, **options)).eval()

    def reset(self) -> None:
        """Clear the state of the last episode."""
        self._policy.reset()

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], **_) -> Tensor:
        """(1, 21): hand pose m, w x y z; stiffness Nm/rad; damping ratio. Raises ValueError for more than one sample."""
        state = batch[OBS_STATE]
        if state.shape[0] != 1:
            raise ValueError(f"{OBS_STATE}: expected one sample, as the policy has one memory, got {state.shape[0]}")
        values = state[0].cpu().numpy().astype(float)
        target = self._policy.act(values[:9], values[9:18], values[27:51].reshape(8, 3), values[51:].reshape(8, 2))
        parts = (target.position, quaternion_from_matrix(target.rotation), target.stiffness, target.damping_ratio)
        return torch.from_numpy(np.concatenate(parts)).float()[None]

    def predict_action_chunk(self, batch: dict[str, Tensor], **_) -> Tensor:
        """(1, 1, 21): a chunk of one."""
        return self.select_action(batch)[:, None]

    def forward(self, batch: dict[str, Tensor]):
        """Raises NotImplementedError."""
        raise NotImplementedError(f"policy np is trained by np_training; {ACTION} has no loss here")

    def get_optim_params(self) -> dict:
        """Nothing to train."""
        return {}
