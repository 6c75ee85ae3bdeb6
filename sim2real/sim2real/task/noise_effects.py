"""What of the detector's stage is worth naming: effects by their catalogue's names, with numbers that a patch takes."""

from __future__ import annotations

from dataclasses import asdict

from sim2real.effects import CAMERA_EFFECTS
from sim2real.effects.sentences import ValueWithInterval, describe_effect
from sim2real.task.keypoint_noise import KeypointNoise
from sim2real.thresholds import THRESHOLDS

NOBODYS = ValueWithInterval(0.0, 0.0, 0.0)


def visible_noise_effects(found: KeypointNoise) -> dict[str, dict[str, ValueWithInterval]]:
    """Parameters by effect, of those that are visible: the whole interval is beyond the limit that the effect declares."""
    named = {
        "keypoint_noise": ("spread", {"spread": found.spread, "memory": found.memory}),
        "keypoint_outliers": ("share", {"share": found.share, "size": found.size}),
        "frame_drop": ("share", {"share": found.repeated or NOBODYS}),
    }
    seen = {
        name: values
        for name, (size, values) in named.items()
        if values[size].low > CAMERA_EFFECTS[name].detection_limit.limit
    }
    if found.spread.value < THRESHOLDS.scatter.noiseless:
        seen.pop("frame_drop", None)  # an object that rests looks the same in every image
    if found.size.low < THRESHOLDS.scatter.gross:  # the long tail of a small scatter harms nobody
        seen.pop("keypoint_outliers", None)
    return seen


def sentences(found: KeypointNoise) -> list[str]:
    """What was found, in words."""
    said = [
        describe_effect(CAMERA_EFFECTS[name], str(CAMERA_EFFECTS[name].target), values, "the simulator")
        for name, values in visible_noise_effects(found).items()
    ]
    lines = [f"{text[0].upper()}{text[1:]}." for text in said]
    return lines or ["Corners are found where they are, as far as this recording shows."]


def document(found: KeypointNoise) -> dict:
    """The JSON object: every number with its interval, and `visible_noise_effects` as a patch has them."""
    patch = [
        {
            "effect": name,
            "component": str(CAMERA_EFFECTS[name].target),
            "parameters": {key: value.value for key, value in values.items()},
        }
        for name, values in visible_noise_effects(found).items()
    ]
    return {**asdict(found), "effects": patch, "sentences": sentences(found)}
