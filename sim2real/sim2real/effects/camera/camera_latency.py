"""Camera latency: an image shows what was there some time before its stamp."""

from __future__ import annotations

from sim2real.effects.record import Quantity
from sim2real.effects.view_record import Part, Seen, ViewRecord

RECORD = ViewRecord(
    "camera_latency",
    Part.CAMERA,
    (Quantity("delay", "s", -0.3, 0.3),),
    Seen("s", 0.003, largest=40.0),
    "images show the scene {delay:ms earlier/later} than their stamps say",
    age=lambda given, stamp: given["delay"],
)
