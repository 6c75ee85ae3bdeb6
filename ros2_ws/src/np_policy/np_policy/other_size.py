"""An object of another size than the one that a pre-contact policy was trained with, which is the only one that it knows.

The policy is shown the box it knows in the object's place, on the same surface. The hand pose that it chooses there is carried over to
the object: along the face in proportion to its size, and before it where training lets the fingers stand.
"""

from __future__ import annotations

import numpy as np

from np_description.domains import Domain, Pose, resting_height
from np_description.objects.choice import DEFAULT, domain_with
from np_description.rotations import matrix_from_quaternion
from np_policy.stand_off import CLEARANCE, gap

SAME = 1e-6  # m


def known_domain(domain: Domain, choice: str = DEFAULT) -> Domain | None:
    """The domain with the box that weights know, where the object of `domain` has another size; else None. choice: the object that
    they were trained with, as np_description.objects.choice names it."""
    known = domain_with(domain.name, choice)
    return None if np.allclose(known.half_size, domain.half_size, rtol=0, atol=SAME) else known


def known_in_place(domain: Domain, known: Domain, objekt: Pose) -> Pose:
    """Where the known box rests in place of the object: turned the same, its lowest point as high."""
    higher = resting_height(known, objekt.quaternion) - resting_height(domain, objekt.quaternion)
    return Pose(objekt.position + np.array([0.0, 0.0, higher]), objekt.quaternion)


def carried_over(domain: Domain, known: Domain, objekt: Pose, hand: Pose, opening: float) -> Pose:
    """A hand pose that was chosen for the known box in the object's place, as it is for the object. opening: of each finger,
    m."""
    turn = matrix_from_quaternion(objekt.quaternion)
    local = turn.T @ (hand.position - known_in_place(domain, known, objekt).position)
    larger = np.asarray(domain.half_size) / np.asarray(known.half_size)
    scaled = Pose(objekt.position + turn @ (local * larger), hand.quaternion)
    apart, normal = gap(domain, objekt, scaled, opening)
    return Pose(scaled.position + (CLEARANCE - apart) * normal, hand.quaternion)
