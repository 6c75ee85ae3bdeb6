"""Friction of the table and the object's mass that readings of forces are most probable with, and how sure both are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from np_description.domains import Task
from np_description.scene import contact_model
from sim2real.task.contact_force.readings import ForceReading
from sim2real.thresholds import THRESHOLDS

FORCE = THRESHOLDS.friction_and_mass
GRAVITY = 9.81
UNKNOWN = 1.5  # standard deviation of a number, a logarithm, before anything is known
TAILS = 1.5  # deviations from which on a reading counts less: now and then the tip slips, or the object tips


@dataclass(frozen=True)
class NominalContact:
    """Nominal friction and mass."""

    table: float
    """Coefficient of friction of the object with the table."""
    mass: float
    """Mass kg of the object."""
    finger: float
    """Coefficient of friction of the object with a fingertip."""

    @classmethod
    def of(cls, domain: Task) -> NominalContact:
        """The nominal contact of a domain."""
        contact = contact_model(domain, domain.contact)
        return cls(contact.table, domain.mass, contact.finger)


def predict_forces(numbers: np.ndarray, used: Sequence[ForceReading], believed: NominalContact) -> np.ndarray:
    """Forces (n,) N of the readings with numbers (2,): logarithms of table friction and mass over the nominal ones."""
    table, mass = np.exp(numbers) * (believed.table, believed.mass)
    return np.array([table * (r.normal + mass * GRAVITY) for r in used])


def fit_friction_and_mass(
    used: Sequence[ForceReading], believed: NominalContact, free: Sequence[int] = (0, 1)
) -> tuple[np.ndarray, np.ndarray, float]:
    """Numbers (2,), as of `predict_forces`, their covariance (2, 2), and errors over usual ones; numbers that are not free stay nominal.

    Nuisances are what each group's forces, and what normal forces of each, have in common."""
    force = np.array([r.force for r in used])
    own = np.array([np.hypot(r.deviation, believed.table * r.normal_deviation) for r in used])
    names = list(dict.fromkeys(r.group for r in used))
    member = np.array([[r.group == name for name in names] for r in used], float)
    places = list(free)

    def left(x: np.ndarray) -> np.ndarray:
        numbers, common = np.zeros(2), x[len(places) :]
        numbers[places] = x[: len(places)]
        return (force - predict_forces(numbers, used, believed) - FORCE.common * member @ common) / own

    def off(x: np.ndarray) -> np.ndarray:
        return np.concatenate([left(x), x[: len(places)] / UNKNOWN, x[len(places) :]])

    found = least_squares(off, np.zeros(len(places) + len(names)), loss="soft_l1", f_scale=TAILS)
    errors = np.abs(left(found.x))
    misfit = 1.4826 * float(np.median(errors)) * np.sqrt(len(used) / max(len(used) - len(places), 1))
    inverse = np.linalg.inv(found.jac.T @ found.jac) * _scale(misfit, len(used) - len(places))
    numbers, covariance = np.zeros(2), np.zeros((2, 2))
    numbers[places] = found.x[: len(places)]
    covariance[np.ix_(places, places)] = inverse[: len(places), : len(places)]
    return numbers, covariance, misfit


def _scale(misfit: float, left: int) -> float:
    """Factor of the readings' variance, by how far off they are in this recording. The usual errors
    count as some readings more, beside `left` that no number takes."""
    return float((FORCE.usually + max(left, 0) * misfit**2) / (FORCE.usually + max(left, 0)))


def jackknife_factor(used: Sequence[ForceReading], believed: NominalContact, covariance: np.ndarray) -> float:
    """By how much the variance of the numbers is larger, by a jackknife over experiments, than by the readings' own errors."""
    names = list(dict.fromkeys(r.experiment for r in used))
    if len(names) < 3:
        return 1.0
    without = np.array(
        [fit_friction_and_mass([r for r in used if r.experiment != name], believed)[0] for name in names]
    )
    spread = (len(names) - 1) * np.var(without, axis=0)
    return float(np.max(spread / np.diag(covariance)))
