"""Clock offset: the camera's stamps are of another clock, which is off and drifts."""

from __future__ import annotations

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity

EFFECT = Effect(
    "clock_offset",
    EffectTarget.CAMERA,
    (Quantity("offset", "s", -0.5, 0.5), Quantity("drift", "1", -1e-3, 1e-3)),
    detection_limit=DetectionLimit("s", 0.003, largest=100.0),
    sentence_template="the camera's clock is {offset:ms ahead/behind} and gains {drift:ppm}",
    image_age=lambda values, stamp: values["offset"] + values["drift"] * stamp,
)
