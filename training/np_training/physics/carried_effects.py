"""Effects of a patch.yaml that the batched simulator can carry: those that are numbers of its rigid-body model.

The rest needs a drive or sensors with a memory, or a gravity that the arm does not compensate, which the captured graph does
not have: it is refused by name.
"""

from __future__ import annotations

from pathlib import Path

from np_effects import RECORDS
from np_effects.patch import Patch, load_patch

CARRIED = tuple(record.id for record in RECORDS.values() if record.is_rigid)


def check_carried(patch: Patch) -> None:
    """Raise ValueError naming the effects that the batched simulator cannot carry."""
    others = sorted({f"{e.effect} at {e.component}" for e in patch.effects if not e.record.is_rigid})
    if others:
        raise ValueError(
            f"effects: training carries {', '.join(CARRIED)}; expected a patch of these, got {', '.join(others)}. "
            "Take them out, or evaluate through the graph, whose simulator has them (make evaluate EFFECTS=...)"
        )


def load_effects(path: str | Path | None) -> Patch:
    """The patch in a file, the nominal arm for None. Raises ValueError for what is no patch or cannot be carried."""
    patch = load_patch(path) if path else Patch()
    check_carried(patch)
    return patch
