"""What the nominal model predicts at the samples of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim2real.arm.rigid_body import LinkMotion


@dataclass(frozen=True, eq=False)
class Prediction:
    """Nominal torques of samples, in Nm."""

    gravity: np.ndarray
    """(n, k), holds the arm."""
    inertial: np.ndarray
    """(n, k), accelerates it, Coriolis terms included, rotors not."""
    rotors: np.ndarray
    """(n, k), accelerates the rotors."""
    friction: np.ndarray
    """(n, k), overcomes joint friction and damping."""
    total: np.ndarray
    """(n, k), what the sensor should have shown; with gravity only if the sensor's torque has it."""
    load: np.ndarray
    """(n, k), through the gear."""
    direction: np.ndarray
    """(n, k), direction of motion, -1..1."""
    motion: LinkMotion
    """Motion of the links."""
    gravity_slope: np.ndarray
    """(n, k, k) Nm/rad, change of joint i's gravity torque with position j."""
    inertia: np.ndarray
    """(n, k, k), torque of joint i that turns link j about its own centre of mass."""
    link_errors: tuple[np.ndarray, ...]
    """(n, c) of each joint: one standard deviation of the links' usual errors, component by component."""
