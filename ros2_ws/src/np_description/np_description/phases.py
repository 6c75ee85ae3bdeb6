"""The phases of an episode, and their fields in `episode/phase` and `episode/tick` (docs/reference/graph.md)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields

IDLE, PRE, APPROACH, POST = "idle", "pre", "approach", "post"
SUCCEEDED, FAILED, FAULT = "succeeded", "failed", "fault"
EXCITE = "excite"  # an experiment on the bare arm, which has a name
ACTIVE = (PRE, APPROACH, POST)
ENDS = (SUCCEEDED, FAILED, FAULT)
AT_REST = (IDLE, *ENDS)  # nothing is under way, and nothing is required of the arm
_BOUND = re.compile(r"[0-9]+(\.[0-9]+)?")
PHASES = (*AT_REST, *ACTIVE, EXCITE)


@dataclass(frozen=True)
class PhaseState:
    """The phase in force. As text it is one line: "failed: post: timeout", "excite: dwell". Raises ValueError for an unknown phase, or a stamp or bound that is no number."""

    phase: str
    """One of PHASES."""
    reason: str = ""
    """Why, where there is something to explain."""
    experiment: str = ""
    """Name of the experiment under way."""
    since: str = ""
    """Stamp ns, as text, of the first keypoints that count, of a `pre` in which a contact is chosen anew."""
    position_bound: str = ""
    """Of an end: twice the standard deviation of the estimated position, m, as text; "" without an estimate."""
    angle_bound: str = ""
    """Likewise of the orientation, rad."""

    def __post_init__(self) -> None:
        if self.phase not in PHASES:
            raise ValueError(f"phase: expected one of {', '.join(PHASES)}, got '{self.phase}'")
        if self.since and not (self.since.isascii() and self.since.isdigit()):
            raise ValueError(f"since: expected a stamp in ns, got '{self.since}'")
        for name in ("position_bound", "angle_bound"):
            if (text := getattr(self, name)) and not _BOUND.fullmatch(text):
                raise ValueError(f"{name}: expected a number that is not negative, got '{text}'")

    def __str__(self) -> str:
        return ": ".join(part for part in (self.phase, self.experiment, self.reason) if part)

    @property
    def values(self) -> dict[str, str]:
        """The documented keys and their values, without empty ones."""
        return {field.name: text for field in fields(self) if (text := getattr(self, field.name))}

    @classmethod
    def of(cls, values: Mapping[str, str]) -> PhaseState:
        """The state that `values` were made from; other keys are ignored. Raises ValueError without a known `phase`."""
        if "phase" not in values:
            raise ValueError(f"expected the key phase, got {', '.join(values) or 'no keys'}")
        return cls(**{field.name: values[field.name] for field in fields(cls) if field.name in values})


def split_reason(text: str) -> tuple[str, str]:
    """The part of a text before its first colon, and the rest: "post: timeout" -> ("post", "timeout").

    The reason of `failed` begins with the phase that failed.
    """
    head, _, rest = text.partition(":")
    return head.strip(), rest.strip()


def first_end(states: Iterable[PhaseState]) -> PhaseState | None:
    """The first end of an episode among published phases, or None: later phases are of no episode any more."""
    return next((state for state in states if state.phase in ENDS), None)
