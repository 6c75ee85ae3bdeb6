"""The output of the pre-contact student: a hand pose and a finger opening as 10 numbers.

6D rotation, position scaled to +-1 around the workspace, opening scaled to 0..1. Array-generic: training encodes the
teacher's choice with PyTorch, the node decodes with NumPy.
"""

from __future__ import annotations

from np_common.rotations import matrix_from_six, namespace, six_from_matrix
from np_description.panda import FINGER_MAX

SIZE = 10
# Weights are refused that were trained with another version. Raise it whenever `decode` makes something else of the same ten
# numbers; a test holds it to that.
VERSION = 1
POSITION_CENTRE, POSITION_RANGE = (0.5, 0.0, 0.1), 0.2  # m


def encode(position, rotation, opening):
    """The 10 numbers (..., 10) of T_E position (..., 3) m, rotation (..., 3, 3), finger opening (...) m."""
    xp = namespace(position)
    return xp.concatenate(
        [six_from_matrix(rotation), (position - _centre(position)) / POSITION_RANGE, opening[..., None] / FINGER_MAX],
        axis=-1,
    )


def decode(output):
    """Position (..., 3) m, rotation (..., 3, 3) and finger opening (...) m, cut to what the gripper can, of (..., 10)."""
    xp = namespace(output)
    return (
        output[..., 6:9] * POSITION_RANGE + _centre(output),
        matrix_from_six(output[..., :6]),
        xp.clip(output[..., 9], 0.0, 1.0) * FINGER_MAX,
    )


def _centre(like):
    xp = namespace(like)
    return (
        xp.as_tensor(POSITION_CENTRE, dtype=like.dtype, device=like.device)
        if xp.__name__ == "torch"
        else xp.array(POSITION_CENTRE)
    )
