"""Dropped frames: an image shows the one before again, under a new stamp."""

from __future__ import annotations

from sim2real.effects.record import Quantity
from sim2real.effects.view_record import Part, Seen, ViewRecord

RECORD = ViewRecord(
    "frame_drop",
    Part.CAMERA,
    (Quantity("share", "1", 0.0, 0.9),),
    Seen("1", 0.02),
    "{share:%} of the images show the one before again",
    repeats=lambda given: given["share"],
)
