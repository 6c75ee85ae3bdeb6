"""Object mass: the object is heavier or lighter, its inertia with it."""

from __future__ import annotations

from dataclasses import replace

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity

EFFECT = Effect(
    "object_mass",
    EffectTarget.OBJECT,
    (Quantity("relative", "1", -0.8, 4.0),),
    detection_limit=DetectionLimit("1", 0.1, largest=8.0),
    sentence_template="the object weighs {relative:% more/less}",
    modify_scene=lambda scene, values: replace(scene, mass=scene.mass * (1 + values["relative"])),
)
