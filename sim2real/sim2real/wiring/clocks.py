"""Whether all streams of a recording are stamped by one clock."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from np_description.control_rate import SECOND
from sim2real.thresholds import THRESHOLDS
from sim2real.wiring.fault import WiringFault

WIRING = THRESHOLDS.wiring
SURELY = 6.0  # standard errors of a drift


def find_clock_fault(
    headers: Mapping[str, np.ndarray], arrivals: Mapping[str, np.ndarray], reference: str = "joint_states"
) -> WiringFault | None:
    """Of streams by topic: header stamps (n,) ns, and the times (n,) ns at which they were recorded.

    A stream's age on arrival is its latency, unless its clock is another one: then it is negative, or differs from that of the reference by
    more than `WIRING.latest`, or drifts. Where a recorder logs header stamps as times, the streams begin and end apart instead.
    """
    age = {topic: (arrivals[topic] - headers[topic]) / SECOND for topic in headers if len(headers[topic])}
    if reference not in age:
        return None
    start, end = headers[reference][0] / SECOND, headers[reference][-1] / SECOND
    for topic, own in age.items():
        if topic == reference or len(own) < WIRING.least_stamps:
            continue
        stamps = headers[topic] / SECOND
        away = float(np.median(own) - np.median(age[reference]))
        drift = _drift(stamps - stamps[0], own)
        early, late = start - stamps[0], stamps[-1] - end
        if abs(away) > WIRING.latest or away < -WIRING.earliest:
            text = f"are {abs(away):.3g} s {'behind' if away > 0 else 'ahead of'} the clock of {reference}"
        elif abs(drift) > WIRING.drift:
            text = f"drift by {1e6 * drift:.0f} microseconds a second against the clock of {reference}"
        elif early > WIRING.latest or late > WIRING.latest:
            away = -max(early, late) if late > early else max(early, late)
            text = f"lie up to {max(early, late):.3g} s outside those of {reference}"
        else:
            continue
        return WiringFault(
            "clock",
            topic,
            f"Stamps of {topic} {text}: two clocks.",
            "Synchronise the clocks of both machines (chrony, PTP), or stamp on arrival.",
        )
    return None


def _drift(time: np.ndarray, age: np.ndarray) -> float:
    """Slope of the age (n,) s over time (n,) s; 0 where it may be jitter, or too little of it is seen."""
    if time[-1] < WIRING.drift_span:
        return 0.0
    slope, constant = np.polyfit(time, age, 1)
    error = np.std(age - slope * time - constant) / (np.std(time) * np.sqrt(len(time)))
    return float(slope) if abs(slope) > SURELY * error else 0.0
