"""Operational-space control of T_E (Khatib, IEEE J. Robotics and Automation 1987) with gains of the policy's choice: the paper's baseline.

tau = J' Lambda (kp e - kd v) + N' M (kp_n (q_p - q) - kd_n dq) + coriolis, Lambda = (J M^-1 J')^-1: the end
effector behaves as a unit mass on a spring of its own in every direction, and what is left of the arm keeps a posture. That the policy
chooses the springs, step by step, is VICES (Martin-Martin et al., IROS 2019).
"""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace, vector_from_matrix
from np_control.impedance import STIFFNESS_MAX, STIFFNESS_MIN
from np_control.kinematics import forward_kinematics, jacobian

REGULARISATION = 1e-4  # added to J M^-1 J', whose entries are 0.1 to 10 away from singularities
SOFTEST, STIFFEST = 50.0, 600.0  # 1/s^2, per unit inertia, in each direction: 1.1 to 3.9 Hz
POSTURE = 20.0  # 1/s^2, critically damped
DIRECTIONS = 6


def chosen_gains(stiffness, ratio):
    """What gains for seven joints mean for T_E: (..., 7), the stiffness of position and rotation, x, y, z, in 1/s^2, then one damping ratio.

    stiffness (..., 7) Nm/rad and ratio (..., 7), NumPy or PyTorch, are what an action says (np_policy.action). A direction has its share of
    the range from SOFTEST to STIFFEST that one of the first six joints would have of its own; the ratio is the mean.
    """
    low, high = (limit[:DIRECTIONS] for limit in (STIFFNESS_MIN, STIFFNESS_MAX))
    xp = namespace(stiffness)
    if xp is not np:
        low, high = (xp.as_tensor(limit, dtype=stiffness.dtype, device=stiffness.device) for limit in (low, high))
    share = (stiffness[..., :DIRECTIONS] - low) / (high - low)
    parts = (SOFTEST + share * (STIFFEST - SOFTEST), ratio.mean(-1)[..., None])
    return xp.concatenate(parts, -1)


def operational_space_torque(
    q: np.ndarray,
    dq: np.ndarray,
    position: np.ndarray,
    rotation: np.ndarray,
    posture: np.ndarray,
    gains: np.ndarray,
    mass_matrix: np.ndarray,
    coriolis: np.ndarray,
) -> np.ndarray:
    """Torque (7,) Nm without gravity that draws T_E to position (3,) m and rotation (3, 3) in the base frame.

    q, posture (7,) rad; dq (7,) rad/s; gains (7,): see `chosen_gains`; mass_matrix (7, 7) kg m^2 and coriolis (7,) Nm at (q, dq).
    """
    at, turned = forward_kinematics(q)
    matrix = jacobian(q)
    error = np.concatenate([position - at, vector_from_matrix(rotation @ turned.T)])
    stiffness, ratio = gains[:DIRECTIONS], gains[DIRECTIONS]
    acceleration = stiffness * error - 2 * ratio * np.sqrt(stiffness) * (matrix @ dq)
    mobility = np.linalg.solve(mass_matrix, matrix.T)  # M^-1 J'
    inertia = np.linalg.inv(matrix @ mobility + REGULARISATION * np.eye(6))
    rest = POSTURE * (posture - q) - 2 * np.sqrt(POSTURE) * dq
    inner = mass_matrix @ rest
    inner = inner - matrix.T @ (inertia @ (mobility.T @ inner))  # nothing of it accelerates T_E
    return matrix.T @ (inertia @ acceleration) + inner + coriolis
