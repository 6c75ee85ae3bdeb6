"""The phases of an episode, as `phase` and `tick` name them (docs/reference/graph.md)."""

from __future__ import annotations

from collections.abc import Iterable

IDLE, PRE, APPROACH, POST = "idle", "pre", "approach", "post"
SUCCEEDED, FAILED, FAULT = "succeeded", "failed", "fault"
EXCITE = "excite"  # an experiment on the bare arm, whose name follows as the reason
ACTIVE = (PRE, APPROACH, POST)
ENDS = (SUCCEEDED, FAILED, FAULT)
AT_REST = (IDLE, *ENDS)  # nothing is under way, and nothing is asked of the arm


def split_phase(text: str) -> tuple[str, str]:
    """Phase and reason of what a message says: "failed: post: timeout" -> ("failed", "post: timeout")."""
    phase, _, reason = text.partition(":")
    return phase.strip(), reason.strip()


def first_end(said: Iterable[tuple[str, str]]) -> tuple[str, str] | None:
    """The first end of an episode among phases and reasons, or None: what comes after it is of no episode any more."""
    return next((each for each in said if each[0] in ENDS), None)
