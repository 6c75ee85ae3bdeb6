"""Gripper friction: another coefficient of the object with a fingertip."""

from __future__ import annotations

from dataclasses import replace

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity

EFFECT = Effect(
    "gripper_friction",
    EffectTarget.CONTACT,
    (Quantity("relative", "1", -0.9, 2.0),),
    detection_limit=DetectionLimit("1", 0.06, largest=8.0),
    sentence_template="the object has {relative:% more/less} friction with a fingertip",
    modify_scene=lambda scene, values: replace(scene, finger=scene.finger * (1 + values["relative"])),
)
