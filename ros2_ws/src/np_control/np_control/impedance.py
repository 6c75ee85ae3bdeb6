"""The joint impedance law, and the gains a policy may request.

One definition for the 500 Hz node, the sim bridge's own hold, the hardware driver and the parity test of the GPU
environments: tau = kp (q_d - q) - kd dq + coriolis, kd = rho sqrt(kp), rho >= 0.5 (paper). Gravity is the backend's.
"""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace

STIFFNESS_MIN = np.array([40.0, 40.0, 40.0, 40.0, 10.0, 10.0, 10.0])
STIFFNESS_MAX = np.array([400.0, 400.0, 400.0, 400.0, 100.0, 100.0, 100.0])
"""Nm/rad. The upper end keeps kd dt / M below one for the wrist (M of about 0.1 kg m^2) at the 5 ms step of training."""
DAMPING_RATIO_MIN = 0.5  # paper
DAMPING_RATIO_MAX = 2.0


def damping(stiffness, ratio):
    """Damping kd (..., 7) Nms/rad of stiffness kp (..., 7) Nm/rad and ratio rho (..., 7)."""
    return ratio * namespace(stiffness).sqrt(stiffness)


def torque(q, dq, q_target, stiffness, damping_ratio, coriolis):
    """Commanded torque (..., 7) Nm without gravity.

    q, q_target (..., 7) rad; dq (..., 7) rad/s; stiffness (..., 7) Nm/rad; damping_ratio (..., 7); coriolis (..., 7) Nm
    at (q, dq). NumPy or PyTorch.
    """
    return stiffness * (q_target - q) - damping(stiffness, damping_ratio) * dq + coriolis


def velocity_feedforward_offset(target, velocity, stiffness, damping_ratio):
    """Joint target (..., 7) rad to give the law for a target that moves at `velocity` (..., 7) rad/s.

    The law damps absolute velocity. A target ahead by kd/kp times its velocity turns that into damping of the
    velocity error, so that a moving target is not trailed.
    """
    return target + damping(stiffness, damping_ratio) / stiffness * velocity
