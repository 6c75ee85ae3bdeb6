"""Published text is the same wherever the repository lies."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def relative(text: str) -> str:
    """A text, a traceback mostly, with the files of the repository by their place in it."""
    return text.replace(f"{ROOT}/", "")
