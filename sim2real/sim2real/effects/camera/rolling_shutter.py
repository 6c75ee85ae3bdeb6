"""Rolling shutter: the rows of an image are of different moments, the first of the earliest."""

from __future__ import annotations

from sim2real.effects.record import Quantity
from sim2real.effects.view_record import Part, Seen, ViewRecord

RECORD = ViewRecord(
    "rolling_shutter",
    Part.CAMERA,
    (Quantity("duration", "s", 0.0, 0.1),),
    Seen("s", 0.006),
    "an image takes {duration:ms} from its first row to its last",
    rows=lambda given: given["duration"],
)
