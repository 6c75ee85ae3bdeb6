"""An object of another size than the one that a pre-contact policy was trained with.

The policy is shown the trained box in the object's place, on the same surface. The hand pose that it chooses there is carried over to
the object: along the face in proportion to its size, and before it where training lets the fingers stand. NumPy or PyTorch; poses in
the base frame: position (..., 3) m, quaternion (..., 4) wxyz, rotation (..., 3, 3).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from np_common.rotations import matrix_from_quaternion
from np_description.domains import Task
from np_description.objects.choice import DEFAULT, domain_with
from np_planning.stand_off import CLEARANCE, array_like, finger_gap

SAME = 1e-6  # m
SIZES = "sizes"  # of the metadata of weights that were trained with several


def read_size_range(metadata: Mapping[str, str]) -> tuple[float, float]:
    """Least and greatest factor of all edges that weights were trained with, by their metadata."""
    low, high = metadata.get(SIZES, "1 1").split()
    return float(low), float(high)


def find_trained_domain(
    domain: Task, object_ref: str = DEFAULT, sizes: tuple[float, float] = (1.0, 1.0)
) -> Task | None:
    """The domain with the box that weights were trained with, where the object of `domain` has another size; else None.

    object_ref: the object that they were trained with, as np_description.objects.choice names it; sizes: least and greatest factor of its edges.
    """
    known = domain_with(domain.name, object_ref)
    nearest = np.clip(np.mean(np.divide(domain.half_size, known.half_size)), *sizes) * np.array(known.half_size)
    return None if np.allclose(nearest, domain.half_size, rtol=0, atol=SAME) else known


def canonical_object_position(domain: Task, known: Task, position, quaternion):
    """Where (..., 3) m the centre of the known box is in place of the object: turned the same, its lowest point as high."""
    larger = array_like(np.subtract(known.half_size, domain.half_size), position)
    higher = (abs(matrix_from_quaternion(quaternion)[..., 2, :]) * larger).sum(-1)
    return position + higher[..., None] * array_like((0.0, 0.0, 1.0), position)


def transfer_contact_position(domain: Task, known: Task, position, quaternion, hand, rotation, opening):
    """Where (..., 3) m T_E goes before the object at position and quaternion, chosen at `hand`, with that rotation and opening (...) m
    of each finger, for the known box in its place."""
    turn = matrix_from_quaternion(quaternion)
    local = ((hand - canonical_object_position(domain, known, position, quaternion))[..., None] * turn).sum(-2)
    scaled = position + (
        turn * (local * array_like(np.divide(domain.half_size, known.half_size), local))[..., None, :]
    ).sum(-1)
    apart, normal = finger_gap(domain, position, quaternion, scaled, rotation, opening)
    return scaled + (CLEARANCE - apart)[..., None] * normal
