"""The guards of the arm: limits, command validation, watchdog, and the filter a backend runs every period.

Pure NumPy and clock-free: every function takes the time as an argument. So the sim bridge, the hardware driver
and the controller share one definition and one behaviour.
"""

from np_control.safety.commands import Command, check_command
from np_control.safety.filter import AppliedCommand, SafetyFilter
from np_control.safety.limits import (
    LIMITS,
    SafetyLimits,
    clamp_torque,
    limit_gains,
    limit_target,
    limit_torque,
    slew_gains,
    torque_bounds,
    velocity_bounds,
)
from np_control.safety.press import press_force_scale, tip_force
from np_control.safety.refusals import Reason, Refusal, Refusals, check_finite
from np_control.safety.watchdog import State, Watchdog

__all__ = [
    "AppliedCommand",
    "Command",
    "LIMITS",
    "Reason",
    "Refusal",
    "Refusals",
    "SafetyFilter",
    "SafetyLimits",
    "State",
    "Watchdog",
    "check_command",
    "check_finite",
    "clamp_torque",
    "limit_gains",
    "limit_target",
    "limit_torque",
    "press_force_scale",
    "slew_gains",
    "tip_force",
    "torque_bounds",
    "velocity_bounds",
]
