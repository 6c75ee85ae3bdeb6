"""Table height: table and obstacles are higher or lower than they are believed to be."""

from __future__ import annotations

from dataclasses import replace

from sim2real.effects.record import Quantity
from sim2real.effects.scene_record import SceneRecord, Whose
from sim2real.effects.view_record import Seen

RECORD = SceneRecord(
    "table_height",
    Whose.ENVIRONMENT,
    (Quantity("height", "m", -0.03, 0.03),),
    Seen("m", 0.001),
    "the table is {height:mm higher/lower}",
    lambda scene, given: replace(scene, lift=scene.lift + given["height"]),
    in_training=False,
)
