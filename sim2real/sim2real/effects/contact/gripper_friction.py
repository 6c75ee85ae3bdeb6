"""Gripper friction: another coefficient of the object with a fingertip."""

from __future__ import annotations

from dataclasses import replace

from sim2real.effects.record import Quantity
from sim2real.effects.scene_record import SceneRecord, Whose
from sim2real.effects.view_record import Seen

RECORD = SceneRecord(
    "gripper_friction",
    Whose.CONTACT,
    (Quantity("relative", "1", -0.9, 2.0),),
    Seen("1", 0.06),
    "the object has {relative:% more/less} friction with a fingertip",
    lambda scene, given: replace(scene, finger=scene.finger * (1 + given["relative"])),
)
