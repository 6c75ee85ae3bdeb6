"""Thresholds of slow planar pushes (chain/)."""

from __future__ import annotations

from dataclasses import dataclass

from np_diagnosis.thresholds.entry import JUDGEMENT, NUMERICS, threshold


@dataclass(frozen=True)
class Pushing:
    """Which windows of a push count (chain/pushing.py)."""

    window: float = threshold(0.1, "s", "length of a window", "longer than a period of an arm's vibration")
    free: float = threshold(0.3, "s", "without contact at the beginning, from which the sensor's bias comes", JUDGEMENT)
    moved: float = threshold(0.001, "m", "from its place at the beginning at which the object has moved", JUDGEMENT)
    onset: float = threshold(5.0, "1", "times the noise from which a force is a contact", JUDGEMENT)
    least_force: float = threshold(0.1, "N", "smallest force of a contact", JUDGEMENT)
    least_speed: float = threshold(0.01, "m/s", "slowest object that slides", JUDGEMENT)
    contact_share: float = threshold(0.3, "1", "of the usual force below which the tip has left", JUDGEMENT)
    settling: int = threshold(3, "windows", "left out where contact begins", JUDGEMENT)
    leaving: int = threshold(2, "windows", "left out where contact ends", JUDGEMENT)
    least_windows: int = threshold(6, "windows", "fewest of a push", JUDGEMENT)
    least_rows: int = threshold(10, "rows", "fewest of a stream", JUDGEMENT)
    least_in_window: int = threshold(3, "rows", "fewest through which a line is drawn", NUMERICS)
    unit: float = threshold(1e-3, "1", "by which the length of a quaternion may differ from one", NUMERICS)


@dataclass(frozen=True)
class PushModel:
    """The quasi-static model (chain/limit_surface.py)."""

    usual_speed: float = threshold(0.1, "m/s", "at which friction is what it is called", JUDGEMENT)
    slowest: float = threshold(0.005, "m/s", "below which friction no longer follows the speed", JUDGEMENT)
    sure_slip: float = threshold(0.01, "m/s", "speed along the face at which the tip slides", JUDGEMENT)
