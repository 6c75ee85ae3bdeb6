"""The press force of an arm that is held up, and the share of the law's torque that limits it.

An impedance law presses by stiffness times the lead of its target over the hand. The target of a planned touch lies below the surface, whose
height is not known yet. The vertical stiffness is 4 to 14 N/mm by posture: the lead alone bounds nothing.
"""

from __future__ import annotations

import numpy as np

from np_control.kinematics import jacobian
from np_control.safety.limits import SafetyLimits

LEVER = 0.25  # m, by which the joints move the hand in the direction in which they do so least: .2 to .3 in reach, 0 for a stretched arm


def tip_force(q: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Force (3,) N of T_E on what holds it up, base frame, by joint torques (7,) Nm without gravity, at joints q (7,) rad.

    Least squares: what no force explains is a moment, or friction.
    """
    return np.linalg.lstsq(jacobian(q)[:3].T, torque, rcond=None)[0]


def press_force_scale(limits: SafetyLimits, q: np.ndarray, torque: np.ndarray) -> float:
    """Share, 0 to 1, of the law's torque (7,) Nm at joints q (7,) rad by which the hand presses with `limits.press` at most.

    Never less than leaves a torque of `LEVER` times that force: by a stretched arm a small torque is a large force, and it would go limp.
    """
    size, gentle = float(np.sqrt(torque @ torque)), LEVER * limits.press
    if size <= gentle:  # almost always, and it costs nothing
        return 1.0
    force = float(np.linalg.norm(tip_force(q, torque)))
    return max(limits.press / force, gentle / size) if force > limits.press else 1.0
