"""The keypoint noise in words and as JSON."""

from __future__ import annotations

from dataclasses import asdict

from sim2real.effects import CAMERA_EFFECTS
from sim2real.effects.sentences import describe_effect
from sim2real.task.keypoint_noise import KeypointNoise, visible_noise_effects


def sentences(noise: KeypointNoise) -> list[str]:
    """One sentence for each visible effect."""
    parts = [
        describe_effect(CAMERA_EFFECTS[name], str(CAMERA_EFFECTS[name].target), values, "the simulator")
        for name, values in visible_noise_effects(noise).items()
    ]
    lines = [f"{text[0].upper()}{text[1:]}." for text in parts]
    return lines or ["Corners are found where they are, as far as this recording shows."]


def document(noise: KeypointNoise) -> dict:
    """Every number with its interval, and the visible effects as `patch.yaml` has them."""
    patch = [
        {
            "effect": name,
            "component": str(CAMERA_EFFECTS[name].target),
            "parameters": {key: value.value for key, value in values.items()},
        }
        for name, values in visible_noise_effects(noise).items()
    ]
    return {**asdict(noise), "effects": patch, "sentences": sentences(noise)}
