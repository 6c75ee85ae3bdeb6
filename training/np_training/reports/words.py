"""Names of a log and of an evaluation in words, for people."""

from __future__ import annotations


def task_label(group: str) -> str:
    """A group of episodes (np_training.tasks.breakdown) or a kind of practice, in words."""
    kind, number = group.rstrip("0123456789"), group[len(group.rstrip("0123456789")) :]
    words = {
        "tips": f"{number} quarter turns over" if number != "1" else "1 quarter turn over",
        "goal": f"goal region {number}",
        "turn": f"turned by up to {number} degrees",
    }
    return words.get(kind, group.replace("_", " "))
