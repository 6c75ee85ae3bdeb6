"""Operational-space control of T_E (Khatib, IEEE J. Robotics and Automation 1987): the paper's baseline.

tau = J' Lambda (kp e - kd v) + N' M (kp_n (q_p - q) - kd_n dq) + coriolis, Lambda = (J M^-1 J')^-1: the end
effector behaves as a unit mass on a spring in every direction, and what is left of the arm keeps a posture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_control.kinematics import forward_kinematics, jacobian
from np_description.rotations import vector_from_matrix

REGULARISATION = 1e-4  # added to J M^-1 J', whose entries are 0.1 to 10 away from singularities


@dataclass(frozen=True)
class CartesianGains:
    """Stiffness per unit inertia, 1/s^2, of position, rotation, posture; damping ratio, 1 for critical."""

    position: float = 200.0
    rotation: float = 200.0
    posture: float = 20.0
    damping_ratio: float = 1.0


def uniform_gains(stiffness: float) -> CartesianGains:
    """Gains of one stiffness, 1/s^2, in every direction of position and rotation; the others are the defaults.
    Raises ValueError where it is not positive."""
    if not stiffness > 0:
        raise ValueError(f"Cartesian stiffness: expected a positive number of 1/s^2, got {stiffness}")
    return CartesianGains(position=stiffness, rotation=stiffness)


def operational_space_torque(
    q: np.ndarray,
    dq: np.ndarray,
    position: np.ndarray,
    rotation: np.ndarray,
    posture: np.ndarray,
    gains: CartesianGains,
    mass_matrix: np.ndarray,
    coriolis: np.ndarray,
) -> np.ndarray:
    """Torque (7,) Nm without gravity that draws T_E to position (3,) m and rotation (3, 3) in the base frame.

    q, posture (7,) rad; dq (7,) rad/s; mass_matrix (7, 7) kg m^2 and coriolis (7,) Nm at (q, dq).
    """
    at, turned = forward_kinematics(q)
    matrix = jacobian(q)
    error = np.concatenate([position - at, vector_from_matrix(rotation @ turned.T)])
    stiffness = np.repeat([gains.position, gains.rotation], 3)
    acceleration = stiffness * error - 2 * gains.damping_ratio * np.sqrt(stiffness) * (matrix @ dq)
    mobility = np.linalg.solve(mass_matrix, matrix.T)  # M^-1 J'
    inertia = np.linalg.inv(matrix @ mobility + REGULARISATION * np.eye(6))
    rest = gains.posture * (posture - q) - 2 * gains.damping_ratio * np.sqrt(gains.posture) * dq
    inner = mass_matrix @ rest
    inner = inner - matrix.T @ (inertia @ (mobility.T @ inner))  # nothing of it accelerates T_E
    return matrix.T @ (inertia @ acceleration) + inner + coriolis
