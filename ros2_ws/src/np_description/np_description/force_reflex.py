"""The force reflex: at which external force the arm stops itself, and how it estimates that force.

One definition for the hardware driver, both simulators, in-process evaluation and training. Functions take NumPy arrays or PyTorch
tensors of any leading shape and return the same kind.

Sources. libfranka (`Robot::setCollisionBehavior`, `RobotState`) documents that the robot stops where the external torque of a
joint or a component of the hand's wrench exceeds its upper threshold. It documents that both are estimates, that the torque is
filtered (`tau_ext_hat_filtered`, `O_F_ext_hat_K`), and that `automaticErrorRecovery` leaves the stop. Not public are the
observer, the filter's order and time constant, the damping near a singularity and the frame of the components. So this
definition compares the norms of force and moment: they do not depend on a frame and are never less than a component.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

import numpy as np

from np_common.rotations import namespace
from np_description.panda import NOMINAL

WRENCH_DAMPING = 0.02  # ours: 1 % of the wrench at singular value .2, the least of the Panda's Jacobian at `ready`


@dataclass(frozen=True)
class ForceReflex:
    """Thresholds and filter. The thresholds are this project's choice, set on the robot by the driver.

    libfranka's examples set 20 N and 20 Nm (`setDefaultBehavior`) for motion in free space, and 100 N and 100 Nm in
    `cartesian_impedance_control.cpp` for motion in contact.
    """

    torque: float = 0.45
    """Threshold of a joint's external torque, as a share of its torque limit."""
    force: float = 40.0
    """Threshold of the external force at the hand, N."""
    moment: float = 12.0
    """Threshold of the external moment about T_E, Nm."""
    time_constant: float = 0.01
    """Time constant of the first-order filter, s. Assumed: the robot's own is not public."""

    def torques(self, limit: np.ndarray = NOMINAL.torque_limit) -> np.ndarray:
        """Threshold (7,) Nm of each joint, for torque limits (7,) Nm."""
        return self.torque * limit

    def wrench(self) -> np.ndarray:
        """Thresholds (6,) N, Nm of the components of force and moment, as `setCollisionBehavior` takes them."""
        return np.repeat([self.force, self.moment], 3)


_IDENTITY = np.eye(6)
FORCE_REFLEX = ForceReflex()
COUNTED_FORCES = (FORCE_REFLEX.force, 25.0)
"""Forces N at which evaluations count stops: the reflex's own, and a stricter one with joints and moment scaled alike."""

STOP, OBSERVE = MODES = "stop", "observe"
"""What a simulated arm does above a threshold: it stops as the robot does, or only counts the stop."""
DEFAULT_MODE = STOP


def external_torque(measured, model):
    """External torque (..., 7) Nm on the joints: what the model needs for the motion without contact, minus what was measured."""
    return model - measured


def hand_wrench(torque, jacobian, damping: float = WRENCH_DAMPING):
    """Wrench (..., 6) N, Nm at the point of `jacobian` (..., 6, 7), in its axes, that explains joint torques (..., 7) Nm best.

    Damped least squares of J^T w = torque: near a singularity the wrench stays below |torque| / (2 damping).
    """
    xp = namespace(torque)
    identity = _IDENTITY if xp is np else xp.eye(6, dtype=torque.dtype, device=torque.device)
    normal = jacobian @ xp.swapaxes(jacobian, -1, -2) + damping**2 * identity
    right = jacobian @ torque[..., None]
    # solve_ex skips the error check, which would stop the GPU's stream; the damping keeps every system regular.
    return np.linalg.solve(normal, right)[..., 0] if xp is np else xp.linalg.solve_ex(normal, right)[0][..., 0]


def filter_step(filtered, raw, dt: float):
    """Next value of the first-order low-pass filter, for a raw value that is constant over dt s. Any shape."""
    return filtered + (1.0 - exp(-dt / FORCE_REFLEX.time_constant)) * (raw - filtered)


def threshold_share(torque, wrench, reflex: ForceReflex = FORCE_REFLEX):
    """Largest share (...) of a threshold that filtered torque (..., 7) Nm and wrench (..., 6) N, Nm reach; the arm stops above 1.

    A reflex with thresholds scaled by s stops above s.
    """
    xp, limits = namespace(torque), reflex.torques()
    if xp is not np:
        limits = xp.as_tensor(limits, dtype=torque.dtype, device=torque.device)
    joints = (abs(torque) / limits).max(-1) if xp is np else (abs(torque) / limits).amax(-1)
    squares = wrench * wrench
    force = squares[..., :3].sum(-1) ** 0.5 / reflex.force
    moment = squares[..., 3:].sum(-1) ** 0.5 / reflex.moment
    return xp.maximum(joints, xp.maximum(force, moment))
