"""One wrong convention in a recording."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WiringFault:
    """A convention that the recording breaks, and what to change."""

    kind: str
    """constant, jump, gravity, swap, sign, degrees, gains, delay, quaternion, frame, action_scale, colours, image, corners or clock."""
    stream: str
    """Topic, and the part of its messages, that breaks it."""
    sentence: str
    """What is wrong, in one sentence."""
    remedy: str
    """What to change, in one sentence."""
    joints: tuple[str, ...] = ()
    """Joints that it concerns; empty for all, or none."""
