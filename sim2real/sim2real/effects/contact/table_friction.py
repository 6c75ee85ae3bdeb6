"""Table friction: another coefficient of the object with table and obstacles."""

from __future__ import annotations

from dataclasses import replace

from sim2real.effects.record import Quantity
from sim2real.effects.scene_record import SceneRecord, Whose
from sim2real.effects.view_record import Seen

RECORD = SceneRecord(
    "table_friction",
    Whose.CONTACT,
    (Quantity("relative", "1", -0.8, 2.0),),
    Seen("1", 0.08),
    "the object has {relative:% more/less} friction with the table",
    lambda scene, given: replace(scene, table=scene.table * (1 + given["relative"])),
)
