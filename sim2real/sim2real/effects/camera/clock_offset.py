"""Clock offset: the camera's stamps are of another clock, which is off and drifts."""

from __future__ import annotations

from sim2real.effects.record import Quantity
from sim2real.effects.view_record import Part, Seen, ViewRecord

RECORD = ViewRecord(
    "clock_offset",
    Part.CAMERA,
    (Quantity("offset", "s", -0.5, 0.5), Quantity("drift", "1", -1e-3, 1e-3)),
    Seen("s", 0.003, largest=100.0),
    "the camera's clock is {offset:ms ahead/behind} and gains {drift:ppm}",
    age=lambda given, stamp: given["offset"] + given["drift"] * stamp,
)
