"""Which effects of a patch.yaml the training carries (np_training.physics.batched_effects).

What no simulated arm carries (the motor's side of a gear, errors of the controller) is refused by name.
"""

from __future__ import annotations

from pathlib import Path

from np_effects import RECORDS
from np_effects.patch import Patch, load_patch

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
