"""Friction and mass by force: which of table and object explains what drags and pushes take.

A drag takes mu (N + m g), and so does a slow push, whose N is what the tip's friction holds the face down or up by. Pushes alone hold friction
and mass nearly as one product; drags that press by different forces distinguish them. A slow slide takes what the coefficient of a simulator gives,
within 1.5 %: an error that all forces share, of friction and not of mass. Where a moving tip hops, as in MuJoCo with `HARD`, it takes 7 % less. The
fingertip's coefficient is what strokes take that slip over a resting object, by different forces in the same proportion. Else it is at least
what it was seen to hold: a tip that hops, and an object that gives way under a scrape, take less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.task.contact_force.external_force import find_external_press, find_external_pull
from sim2real.task.contact_force.fit import (
    GRAVITY,
    UNKNOWN,
    NominalContact,
    fit_friction_and_mass,
    jackknife_factor,
    predict_forces,
)
from sim2real.task.contact_force.readings import ForceReading
from sim2real.task.contact_force.tap_slide import TapSlide
from sim2real.task.hypotheses import HypothesisComparison, MeasuredChanges, compare_hypotheses
from sim2real.thresholds import THRESHOLDS

FORCE = THRESHOLDS.friction_and_mass
NUMBERS = ("table", "mass", "finger")
"""Logarithms of coefficients and mass over the nominal ones; the first two are those of `fit_friction_and_mass`."""
EFFECTS = {"table_friction": ("table",), "object_mass": ("mass",), "gripper_friction": ("finger",)}


@dataclass(frozen=True, eq=False)
class ContactForceResult:
    """Friction and mass as contact forces show them."""

    verdict: str
    """no_gap, identified, ambiguous, unexplained or undetermined."""
    comparison: HypothesisComparison | None
    """Hypotheses for friction and mass; None where the stage abstains."""
    readings: tuple[ForceReading, ...]
    """Readings that count."""
    abstention_reason: str = ""
    """Why the stage abstains, or what nothing explains."""
    misfit: float | None = None
    """Errors of the readings over the usual ones."""
    before: float | None = None
    """Root mean square N of a reading as nominal, where the other experiments estimate friction and mass."""
    after: float | None = None
    """The same with the findings."""
    measured: dict[str, tuple[float, float, float]] | None = None
    """Coefficients `table` and `finger` and `mass` kg with 95 % intervals, of those that were measured."""
    least_finger: float | None = None
    """Least coefficient of the fingertip that explains what it held in drags and scrapes."""


def estimate_friction_and_mass(
    every: Sequence[ForceReading], believed: NominalContact, slid: Sequence[TapSlide] = ()
) -> ContactForceResult:
    """From readings of forces and from slides of objects that were tapped."""
    used = tuple(r for r in every if r.kind != "scrape" and r.follows >= FORCE.follows)
    if len(used) < 3:
        return ContactForceResult(
            "undetermined", None, used, f"{len(used)} drags and pushes went as they should; 3 are needed"
        )
    value, covariance, misfit = fit_friction_and_mass(used, believed)
    covariance = np.maximum(1.0, jackknife_factor(used, believed, covariance)) * covariance
    value, covariance = value - [FORCE.law[0], 0.0], covariance + np.diag([FORCE.law[1] ** 2, 0.0])
    value, covariance = _add_finger(value, covariance, every, believed)
    comparison = compare_hypotheses(_measured_changes(value, covariance))
    held = [
        (r.force - r.deviation) / (r.normal + r.normal_deviation)
        for r in every
        if r.kind == "scrape" or _object_follows(r)
    ]
    before, after = _held_out(used, believed, {one.hypotheses[0].name for one in comparison.findings})
    shared = dict(
        readings=used,
        misfit=misfit,
        before=before,
        after=after,
        measured=_absolute_values(value, covariance, believed),
        least_finger=max(held, default=None),
    )
    if reason := find_external_pull(used, believed) or find_external_press(shared["measured"], slid):
        return ContactForceResult("unexplained", comparison, abstention_reason=reason, **shared)
    if misfit > FORCE.misfit:
        return ContactForceResult(
            "unexplained",
            comparison,
            abstention_reason=f"forces are {misfit:.1f} times as far off as they usually are",
            **shared,
        )
    return ContactForceResult(comparison.verdict, comparison, **shared)


def _add_finger(
    value: np.ndarray, covariance: np.ndarray, every: Sequence[ForceReading], believed: NominalContact
) -> tuple[np.ndarray, np.ndarray]:
    """The numbers with the fingertip's, which is unknown unless strokes slip over an object that rests, all in one proportion."""
    slips = [r for r in every if r.kind == "drag" and abs(r.follows) < FORCE.slips]
    logs = np.array([np.log(max(r.force, 1e-3) / r.normal) for r in slips])
    finger, variance = 0.0, UNKNOWN**2
    if len(slips) > 1:
        own = np.array([np.hypot(r.deviation / r.force, r.normal_deviation / r.normal) for r in slips]) ** 2
        mean = float(np.average(logs, weights=1 / own))
        agree = np.abs(logs - mean) < np.hypot(FORCE.proportion / 2, 2 * np.sqrt(own))  # weak strokes count little
        if agree.all() and not tip_hops(every, np.exp(mean), *np.exp(value) * (believed.table, believed.mass)):
            finger = mean - np.log(believed.finger)
            variance = float(1 / np.sum(1 / own)) + FORCE.proportion**2 / 4 / len(slips)
    full = np.zeros((3, 3))
    full[:2, :2], full[2, 2] = covariance, variance
    return np.append(value, finger), full


def tip_hops(every: Sequence[ForceReading], finger: float, table: float, mass: float) -> bool:
    """Whether tips with coefficient `finger` are not what slips: pressed by more than an object of such a mass on such a table resists, they would
    hold it and lead it along, and strokes by more lead it a part of the way. One that leads it nowhere slips, and is of that proportion itself."""
    holds = table * mass * GRAVITY / max(finger - table, 1e-3)
    more = [r for r in every if r.kind == "drag" and r.normal > FORCE.surely * holds]
    return sum(FORCE.slips <= r.follows < FORCE.follows for r in more) > 1


def _object_follows(reading: ForceReading) -> bool:
    return reading.kind == "drag" and reading.follows >= FORCE.follows


def _measured_changes(value: np.ndarray, covariance: np.ndarray) -> MeasuredChanges:
    usual, gap = zip(FORCE.table, FORCE.mass, FORCE.finger)
    return MeasuredChanges(NUMBERS, value, covariance, np.array(usual), np.array(gap), EFFECTS)


def _held_out(used: Sequence[ForceReading], believed: NominalContact, named: set[str]) -> tuple[float, float]:
    free = [k for k, effect in enumerate(("table_friction", "object_mass")) if effect in named]
    before, after = [], []
    for name in dict.fromkeys(r.experiment for r in used):
        mine, others = [r for r in used if r.experiment == name], [r for r in used if r.experiment != name]
        force = np.array([r.force for r in mine])
        value = fit_friction_and_mass(others, believed, free)[0] if others else np.zeros(2)
        before += list(force - predict_forces(np.zeros(2), mine, believed))
        after += list(force - predict_forces(value, mine, believed))
    return float(np.sqrt(np.mean(np.square(before)))), float(np.sqrt(np.mean(np.square(after))))


def _absolute_values(
    value: np.ndarray, covariance: np.ndarray, believed: NominalContact
) -> dict[str, tuple[float, float, float]]:
    """Value and interval of each coefficient and of the mass, of those that were measured at all."""
    found = {}
    for k, name in enumerate(NUMBERS):
        deviation = float(np.sqrt(covariance[k, k]))
        if deviation < 0.5 * UNKNOWN:
            scale = getattr(believed, name)
            found[name] = tuple(float(scale * np.exp(value[k] + step * deviation)) for step in (0.0, -1.96, 1.96))
    return found
