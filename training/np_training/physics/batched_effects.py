"""Effects of a patch.yaml in the batched simulator: sim2real.effects.arm_effects for all worlds at once, on the simulator's device."""

from __future__ import annotations

from functools import partial

import numpy as np
import torch
from sim2real.effects.arm_effects import ArmEffects
from sim2real.effects.arrays import Arrays
from sim2real.effects.patch import Patch

from np_training.physics.batched_gravity import BatchedHold


def batched_effects(patch: Patch, period: float, device: str) -> ArmEffects | None:
    """What the patch does in every world beside the numbers of the rigid-body model; None where that is nothing. Its arrays are
    tensors (worlds, 7) on the device; period: s between its steps."""
    if not any(
        e.definition.gravity_error or e.definition.drive or e.definition.joints or e.definition.sensors
        for e in patch.arm.effects
    ):
        return None
    return ArmEffects(patch, period, arrays=Arrays(partial(_tensor, device), partial(BatchedHold, device)))


def _tensor(device: str, values: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(np.asarray(values, dtype=np.float32), device=device)
