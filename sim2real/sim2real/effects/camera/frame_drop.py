"""Dropped frames: an image shows the one before again, under a new stamp."""

from __future__ import annotations

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity

EFFECT = Effect(
    "frame_drop",
    EffectTarget.CAMERA,
    (Quantity("share", "1", 0.0, 0.9),),
    detection_limit=DetectionLimit("1", 0.02, largest=8.0),
    sentence_template="{share:%} of the images show the one before again",
    repeats=lambda values: values["share"],
)
