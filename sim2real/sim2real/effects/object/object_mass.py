"""Object mass: the object is heavier or lighter, its inertia with it."""

from __future__ import annotations

from dataclasses import replace

from sim2real.effects.record import Quantity
from sim2real.effects.scene_record import SceneRecord, Whose
from sim2real.effects.view_record import Seen

RECORD = SceneRecord(
    "object_mass",
    Whose.OBJECT,
    (Quantity("relative", "1", -0.8, 4.0),),
    Seen("1", 0.1),
    "the object weighs {relative:% more/less}",
    lambda scene, given: replace(scene, mass=scene.mass * (1 + given["relative"])),
)
