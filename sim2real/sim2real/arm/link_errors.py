"""What the links of any arm are off by, as torques: masses, where they lie, and how they are spread.

A link's numbers come from CAD or from a fit to somebody's arm; glue, cables and cast walls make each of them a few per
cent of it (`sim2real.effects.background`). Its weight is not in here: weight shows at standstill, is what a maker calibrates the
compensation with, and what is left of it is a gap. Its inertia about a joint is known no better than its mass, in a joint
that no weight loads as well.

Thirty-odd numbers of all links give a joint torques that are much alike, so that a few of their principal components
(Karhunen and Loeve) hold the same information: the columns that a fit needs. They are those of states about the arm's resting posture,
the same for every motion of an arm: estimates from one recording hold for the next, also where it is only planned.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sim2real.arm import rigid_body as rigid
from sim2real.arm.model import Arm
from sim2real.effects.background import INERTIA_ERROR, MASS_ERROR, PLACE_ERROR
from sim2real.recordings.signals import Samples
from sim2real.thresholds import THRESHOLDS

NUISANCES = THRESHOLDS.nuisances
STATES = 512  # of which the components are those
ABOUT = 1.0  # rad from the resting posture, or as far as the joint goes
SPEED, RATE = (
    0.3,
    0.8,
)  # largest speed, of a joint's limit, and acceleration, of that limit a second: about those of the suite


def link_error_torques(arm: Arm, samples: Samples) -> tuple[np.ndarray, ...]:
    """Torques (n, c) Nm of each joint that one standard deviation of each component of all links' errors gives the
    samples' motion, in the order of `principal_components`."""
    tables = _error_torques(arm, samples.position, samples.velocity, samples.acceleration)
    return tuple(_joint_columns(arm, tables, joint) @ found for joint, found in enumerate(principal_components(arm)))


@lru_cache(maxsize=8)
def principal_components(arm: Arm) -> tuple[np.ndarray, ...]:
    """Of each joint, directions (5 l, c) in standard deviations of the errors of the l links that it turns: principal
    components of the torques, largest first; those too small to be seen in the joint are left out."""
    rng = np.random.default_rng(0)
    lower = np.maximum(arm.position_lower, arm.rest - ABOUT)
    upper = np.minimum(arm.position_upper, arm.rest + ABOUT)
    speed, rate = SPEED * arm.velocity_limit, RATE * arm.velocity_limit
    tables = _error_torques(
        arm, *(rng.uniform(*ends, (STATES, len(arm))) for ends in ((lower, upper), (-speed, speed), (-rate, rate)))
    )
    found = []
    for joint in range(len(arm)):
        columns = _joint_columns(arm, tables, joint)
        power, directions = np.linalg.eigh(columns.T @ columns / STATES)
        threshold = (NUISANCES.link_torque * arm.torque_limit[joint]) ** 2
        found.append(directions[:, ::-1][:, power[::-1] > threshold])
    return tuple(found)


def _error_torques(arm: Arm, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> list[np.ndarray]:
    """Of each link, torques (n, k, 5) Nm in a motion, without weight, by one standard deviation of each of its errors."""
    motion = rigid.forward_recursion(arm, q, dq, ddq, np.zeros(3))
    return [rigid.regressor(arm, motion, link) @ change for link, change in enumerate(_standard_errors(arm))]


def _joint_columns(arm: Arm, tables: list[np.ndarray], joint: int) -> np.ndarray:
    return np.hstack([tables[link][:, joint] for link in rigid.links_moved_by(arm, joint)])


def _standard_errors(arm: Arm) -> list[np.ndarray]:
    """For each link, changes (10, 5) of its `rigid.PARAMETERS` by one standard deviation: of its mass, with all that is
    proportional to it; of the place of its centre along x, y, z; of its inertia about that centre."""
    found = []
    for link, central in enumerate(rigid.central_inertia(arm)):
        mass, moment = arm.mass[link], arm.moment[link]
        scaled = np.concatenate([[mass], moment, _vectorise(arm.inertia[link])])
        turned = np.concatenate([np.zeros(4), _vectorise(central)])
        moved = PLACE_ERROR * np.linalg.norm(moment) * rigid.mass_centre_change(arm, link)
        found.append(np.column_stack([MASS_ERROR * scaled, moved, INERTIA_ERROR * turned]))
    return found


def _vectorise(matrix: np.ndarray) -> np.ndarray:
    return np.array([matrix[pair] for pair in rigid.PAIRS])
