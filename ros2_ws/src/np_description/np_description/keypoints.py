"""The object's keypoints: the 8 corners of its box, in one fixed order."""

from __future__ import annotations

import numpy as np

from np_common.rotations import matrix_from_quaternion, namespace

COUNT = 8
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
"""Signs (8, 3) of the corners in the object frame; z runs fastest. Index = 4 [x>0] + 2 [y>0] + [z>0]."""


def box_keypoints(half_size, position, quaternion):
    """Corners (..., 8, 3) m of boxes in the frame of the poses.

    half_size (3,) or (..., 3) m, position (..., 3) m, quaternion (..., 4) wxyz; NumPy or PyTorch.
    """
    xp = namespace(position)
    if xp is np:
        signs, half = CORNERS, np.asarray(half_size)
    else:
        signs = xp.as_tensor(CORNERS, dtype=position.dtype, device=position.device)
        half = xp.as_tensor(half_size, dtype=position.dtype, device=position.device)
    local = signs * half[..., None, :]
    rotation = matrix_from_quaternion(quaternion)
    return (rotation[..., None, :, :] * local[..., None, :]).sum(axis=-1) + position[..., None, :]
