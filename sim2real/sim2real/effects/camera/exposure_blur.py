"""Exposure blur: an image is collected for a while before its stamp, and what moves is smeared and seen late by half of it."""

from __future__ import annotations

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity

EFFECT = Effect(
    "exposure_blur",
    EffectTarget.CAMERA,
    (Quantity("duration", "s", 0.0, 0.1),),
    detection_limit=DetectionLimit("s", 0.006, largest=8.0),
    sentence_template="an image is exposed for {duration:ms}",
    exposure=lambda values: values["duration"],
)
