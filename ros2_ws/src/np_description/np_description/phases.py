"""The phases of an episode, as `phase` and `tick` name them (docs/graph.md)."""

from __future__ import annotations

IDLE, PRE, APPROACH, POST = "idle", "pre", "approach", "post"
SUCCEEDED, FAILED, FAULT = "succeeded", "failed", "fault"
EXCITE = "excite"  # an experiment on the bare arm, whose name follows as the reason
ACTIVE = (PRE, APPROACH, POST)
ENDS = (SUCCEEDED, FAILED, FAULT)


def split_phase(text: str) -> tuple[str, str]:
    """Phase and reason of what a message says: "failed: post: timeout" -> ("failed", "post: timeout")."""
    phase, _, reason = text.partition(":")
    return phase.strip(), reason.strip()
