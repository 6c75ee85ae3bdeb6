"""Camera latency: an image shows what was there some time before its stamp."""

from __future__ import annotations

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity

EFFECT = Effect(
    "camera_latency",
    EffectTarget.CAMERA,
    (Quantity("delay", "s", -0.3, 0.3),),
    detection_limit=DetectionLimit("s", 0.003, largest=40.0),
    sentence_template="images show the scene {delay:ms earlier/later} than at their stamps",
    image_age=lambda values, stamp: values["delay"],
)
