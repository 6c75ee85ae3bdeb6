"""Which effects of a patch.yaml the training carries: of the arm np_training.physics.batched_effects, of the view np_training.environment.view.

What no simulated arm carries (the motor's side of a gear, errors of the controller) is refused by name, and so is a table at another height, on which
tasks are drawn, and what becomes of an image in the time that it takes.
"""

from __future__ import annotations

from pathlib import Path

from sim2real.effects import EFFECTS
from sim2real.effects.patch import Patch, load_patch

SUPPORTED = tuple(effect.id for effect in EFFECTS.values() if "training" in effect.supported_in)


def check_supported(patch: Patch) -> None:
    """Raise ValueError naming the effects that no simulator carries."""
    others = sorted(
        {f"{e.effect} at {e.component}" for e in patch.effects if "training" not in e.definition.supported_in}
    )
    if others:
        raise ValueError(
            f"effects: training carries {', '.join(SUPPORTED)}; expected a patch of these, got {', '.join(others)}. Take them out"
        )


def load_effects(path: str | Path | None) -> Patch:
    """The patch in a file, the nominal arm for None. Raises ValueError for what is no patch or cannot be carried."""
    patch = load_patch(path) if path else Patch()
    check_supported(patch)
    return patch
