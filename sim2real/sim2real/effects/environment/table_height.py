"""Table height: table and obstacles are higher or lower than nominal."""

from __future__ import annotations

from dataclasses import replace

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity

EFFECT = Effect(
    "table_height",
    EffectTarget.ENVIRONMENT,
    (Quantity("height", "m", -0.03, 0.03),),
    detection_limit=DetectionLimit("m", 0.001, largest=8.0),
    sentence_template="the table is {height:mm higher/lower}",
    modify_scene=lambda scene, values: replace(scene, lift=scene.lift + values["height"]),
    in_training=False,
)
