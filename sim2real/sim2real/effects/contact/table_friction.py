"""Table friction: another coefficient of the object with table and obstacles."""

from __future__ import annotations

from dataclasses import replace

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity

EFFECT = Effect(
    "table_friction",
    EffectTarget.CONTACT,
    (Quantity("relative", "1", -0.8, 2.0),),
    detection_limit=DetectionLimit("1", 0.08, largest=8.0),
    sentence_template="the object has {relative:% more/less} friction with the table",
    modify_scene=lambda scene, values: replace(scene, table=scene.table * (1 + values["relative"])),
)
