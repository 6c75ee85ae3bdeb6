"""Limits of the robots as this project uses them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from np_control.safety import LIMITS, SafetyLimits

CYCLE_NS = 1_000_000  # the robot's control cycle, 1 kHz

# rad, "Limits for Franka Research 3" of the FCI documentation (control parameters specifications).
_FR3_LOWER = np.array([-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159])
_FR3_UPPER = np.array([2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159])


def cycle_limits(limits: SafetyLimits, **changes) -> SafetyLimits:
    """`limits` for guards that run in every cycle of the robot; the deadlines stay as long as they were."""
    periods = limits.period_ns // CYCLE_NS
    return replace(
        limits,
        period_ns=CYCLE_NS,
        late_periods=periods * limits.late_periods,
        missed_periods=periods * limits.missed_periods,
        **changes,
    )


PANDA_LIMITS = cycle_limits(LIMITS)
"""Of the original Panda, on which the policies were trained: `np_description.panda` names the source."""

FR3_LIMITS = cycle_limits(
    LIMITS,
    position_lower=np.maximum(LIMITS.position_lower, _FR3_LOWER),
    position_upper=np.minimum(LIMITS.position_upper, _FR3_UPPER),
)
"""What is in the range of both arms; speed and torque limits are the Panda's, which the FR3 exceeds."""
