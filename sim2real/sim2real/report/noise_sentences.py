"""The keypoint noise in words and as JSON."""

from __future__ import annotations

from dataclasses import asdict

from sim2real.effects import VIEW_RECORDS
from sim2real.effects.saying import say
from sim2real.task.keypoint_noise import KeypointNoise, visible_noise_effects


def sentences(noise: KeypointNoise) -> list[str]:
    """One sentence for each visible effect."""
    parts = [
        say(VIEW_RECORDS[name], str(VIEW_RECORDS[name].part), values, "the simulator")
        for name, values in visible_noise_effects(noise).items()
    ]
    lines = [f"{text[0].upper()}{text[1:]}." for text in parts]
    return lines or ["Corners are found where they are, as far as this recording shows."]


def document(noise: KeypointNoise) -> dict:
    """Every number with its interval, and the visible effects as `patch.yaml` has them."""
    patch = [
        {
            "effect": name,
            "component": str(VIEW_RECORDS[name].part),
            "parameters": {key: value.value for key, value in values.items()},
        }
        for name, values in visible_noise_effects(noise).items()
    ]
    return {**asdict(noise), "effects": patch, "sentences": sentences(noise)}
