"""The action of the post-contact policy: a residual of the end-effector pose, and joint gains.

20 numbers in [-1, 1]: 3 position and 3 rotation residual in the base frame (the rotation vector multiplies from the
left), 7 stiffnesses, 7 damping ratios (paper). Array-generic: NumPy in the node, PyTorch in training.
"""

from __future__ import annotations

from dataclasses import dataclass

from np_common.rotations import matrix_from_vector, namespace
from np_control.impedance import DAMPING_RATIO_MAX, DAMPING_RATIO_MIN, STIFFNESS_MAX, STIFFNESS_MIN

SIZE = 20
# Weights are refused that were trained with another version. Raise it whenever `decode` makes another target of the same
# action, at the same gain ranges and residual limits, which the weights' contract names itself; a test checks that.
VERSION = 1
RATE = 10  # Hz: what the residual limits of one step are meant for
POSE, STIFFNESS = slice(0, 6), slice(6, 13)  # of the action


class PolicyError(RuntimeError):
    """The output of a network is no action; the message states what it is."""


@dataclass(frozen=True)
class ResidualLimits:
    """zeta: the largest residual of one step, each axis; position m, rotation rad."""

    position: float
    rotation: float


RESIDUAL_LIMITS_INITIAL = ResidualLimits(0.06, 0.1)  # where the paper's curriculum starts
RESIDUAL_LIMITS_FINAL = ResidualLimits(
    0.02, 0.03
)  # zeta*, where it ends; what was deployed is in the weights' contract


@dataclass(frozen=True)
class Target:
    """Target of the controller: T_E position (..., 3) m, rotation (..., 3, 3); stiffness, damping_ratio (..., 7)."""

    position: object
    rotation: object
    stiffness: object
    damping_ratio: object


def decode(action, position, rotation, limits: ResidualLimits, damping_floor: float = DAMPING_RATIO_MIN) -> Target:
    """The target of an action (..., 20), cut to [-1, 1], given T_E now: position (..., 3) m, rotation (..., 3, 3).

    limits, damping_floor (the damping ratio at -1): in deployment those in the contract of the weights that chose the action.
    """
    xp = namespace(action)
    action = xp.clip(action, -1.0, 1.0)
    turn = matrix_from_vector(action[..., 3:6] * limits.rotation)
    share = (action[..., 6:] + 1) / 2
    low, high = STIFFNESS_MIN, STIFFNESS_MAX
    if xp.__name__ == "torch":
        low, high = (xp.as_tensor(a, dtype=action.dtype, device=action.device) for a in (low, high))
    # Geometric: a step of the action changes a soft and a stiff joint by the same factor.
    stiffness = low * (high / low) ** share[..., :7]
    ratio = damping_floor + share[..., 7:] * (DAMPING_RATIO_MAX - damping_floor)
    return Target(position + action[..., :3] * limits.position, turn @ rotation, stiffness, ratio)


def normalise_stiffness(stiffness):
    """Stiffness (..., 7) Nm/rad as a share (..., 7) of its range, 0 to 1: what the gain penalty counts."""
    low, high = STIFFNESS_MIN, STIFFNESS_MAX
    xp = namespace(stiffness)
    if xp.__name__ == "torch":
        low, high = (xp.as_tensor(a, dtype=stiffness.dtype, device=stiffness.device) for a in (low, high))
    return (stiffness - low) / (high - low)
