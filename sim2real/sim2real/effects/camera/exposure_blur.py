"""Exposure blur: an image is collected for a while before its stamp, and what moves is smeared and seen late by half of it."""

from __future__ import annotations

from sim2real.effects.record import Quantity
from sim2real.effects.view_record import Part, Seen, ViewRecord

RECORD = ViewRecord(
    "exposure_blur",
    Part.CAMERA,
    (Quantity("duration", "s", 0.0, 0.1),),
    Seen("s", 0.006),
    "an image is exposed for {duration:ms}",
    exposure=lambda given: given["duration"],
)
