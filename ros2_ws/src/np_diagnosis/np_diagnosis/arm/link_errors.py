"""What the links of any arm are off by, as torques: masses, where they lie, and how they are spread.

A link's numbers come from CAD or from a fit to somebody's arm; glue, cables and cast walls make each of them a few per
cent of it (`np_effects.background`). Its weight is not in here: weight shows at standstill, is what a maker calibrates the
compensation with, and what is left of it is a gap. Its inertia about a joint is known no better than its mass, in a joint
that no weight loads as well.

Thirty-odd numbers of all links give a joint torques that are much alike, so that a few of their principal components
(Karhunen and Loeve) say as much: the columns that a fit needs.
"""

from __future__ import annotations

import numpy as np

from np_diagnosis.arm import rigid
from np_diagnosis.arm.model import Arm
from np_diagnosis.recordings.signals import Samples
from np_diagnosis.thresholds import THRESHOLDS
from np_effects.background import INERTIA_ERROR, MASS_ERROR, PLACE_ERROR

NUISANCES = THRESHOLDS.nuisances


def link_errors(arm: Arm, samples: Samples) -> tuple[np.ndarray, ...]:
    """Torques (n, c) Nm of each joint that one standard deviation of each principal component of all links' errors gives
    the samples' motion, largest first; components too small to be seen in the joint are left out."""
    motion = rigid.move(arm, samples.position, samples.velocity, samples.acceleration, np.zeros(3))
    changes = _changes(arm)
    tables = [rigid.regressor(arm, motion, link) @ change for link, change in enumerate(changes)]
    found = []
    for joint in range(len(arm)):
        columns = np.hstack([tables[link][:, joint] for link in rigid.carried(arm, joint)])
        power, directions = np.linalg.eigh(columns.T @ columns / max(len(columns), 1))
        least = (NUISANCES.link_torque * arm.torque_limit[joint]) ** 2
        found.append(columns @ directions[:, ::-1][:, power[::-1] > least])
    return tuple(found)


def _changes(arm: Arm) -> list[np.ndarray]:
    """For each link, changes (10, 5) of its `rigid.PARAMETERS` by one standard deviation: of its mass, with all that is
    proportional to it; of the place of its centre along x, y, z; of its inertia about that centre."""
    found = []
    for mass, moment, inertia, own in zip(arm.mass, arm.moment, arm.inertia, rigid.centred_inertia(arm)):
        centre = moment / max(mass, 1e-9)
        whole = np.concatenate([[mass], moment, _six(inertia)])
        moved = [
            np.concatenate([[0.0], mass * unit, mass * _six(2 * centre @ unit * np.eye(3) - _outer(centre, unit))])
            for unit in np.eye(3)
        ]
        turned = np.concatenate([np.zeros(4), _six(own)])
        place = PLACE_ERROR * np.linalg.norm(centre)
        found.append(np.column_stack([MASS_ERROR * whole, *(place * m for m in moved), INERTIA_ERROR * turned]))
    return found


def _outer(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.outer(one, other) + np.outer(other, one)


def _six(matrix: np.ndarray) -> np.ndarray:
    return np.array([matrix[pair] for pair in rigid.PAIRS])
