"""Rolling shutter: the rows of an image are of different moments, the first of the earliest."""

from __future__ import annotations

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity

EFFECT = Effect(
    "rolling_shutter",
    EffectTarget.CAMERA,
    (Quantity("duration", "s", 0.0, 0.1),),
    detection_limit=DetectionLimit("s", 0.006, largest=8.0),
    sentence_template="an image takes {duration:ms} from its first row to its last",
    readout_time=lambda values: values["duration"],
)
