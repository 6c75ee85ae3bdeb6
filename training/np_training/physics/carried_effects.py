"""Effects of a patch.yaml in the batched simulator: np_effects.arm_effects for all worlds at once, on the simulator's device.

What no simulated arm carries (the motor's side of a gear, errors of the controller) is refused by name.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import torch

from np_effects import RECORDS
from np_effects.arm_effects import ArmEffects
from np_effects.arrays import Arrays
from np_effects.patch import Patch, load_patch
from np_training.physics.batched_gravity import BatchedHold

CARRIED = tuple(record.id for record in RECORDS.values() if record.is_simulated)


def check_carried(patch: Patch) -> None:
    """Raise ValueError naming the effects that no simulator carries."""
    others = sorted({f"{e.effect} at {e.component}" for e in patch.effects if "training" not in e.record.carriers})
    if others:
        raise ValueError(
            f"effects: training carries {', '.join(CARRIED)}; expected a patch of these, got {', '.join(others)}. Take them out"
        )


def load_effects(path: str | Path | None) -> Patch:
    """The patch in a file, the nominal arm for None. Raises ValueError for what is no patch or cannot be carried."""
    patch = load_patch(path) if path else Patch()
    check_carried(patch)
    return patch


def batched_effects(patch: Patch, period: float, device: str) -> ArmEffects | None:
    """What the patch does in every world beside the numbers of the rigid-body model; None where that is nothing. Its arrays are
    tensors (worlds, 7) on the device; period: s between its steps."""
    if not any(e.record.weight or e.record.drive or e.record.joints or e.record.sensors for e in patch.effects):
        return None
    return ArmEffects(patch, period, arrays=Arrays(partial(_tensor, device), partial(BatchedHold, device)))


def _tensor(device: str, values: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(np.asarray(values, dtype=np.float32), device=device)
