"""What forces show that is neither friction nor mass: something else pulls the object, or presses it onto the table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import least_squares

from sim2real.task.contact_force.fit import GRAVITY, TAILS, UNKNOWN, NominalContact, predict_forces
from sim2real.task.contact_force.readings import ForceReading
from sim2real.task.contact_force.tap_slide import TapSlide, fit_deceleration
from sim2real.thresholds import THRESHOLDS

FORCE, SLIDE = THRESHOLDS.friction_and_mass, THRESHOLDS.tap_slides


def find_external_pull(used: Sequence[ForceReading], believed: NominalContact) -> str:
    """What pulls the object beside the hand, if forces are more probable with it; "" for nothing. Along the table, it takes from readings in
    some directions what it gives to others; downwards, more at one place than at another, it is no mass."""
    directions, places = np.array([r.way for r in used]), np.array([r.place for r in used])
    pull, gain = _fit_extra_force(used, believed, -directions)
    if gain > FORCE.pulled and np.linalg.norm(pull) > FORCE.pull:
        return f"something pulls the object by {pull[0]:.2f} N and {pull[1]:.2f} N (x, y), whatever the hand does"
    away = places - places.mean(axis=0)
    down, gain = _fit_extra_force(used, believed, believed.table * away / FORCE.apart)
    differs = float(np.ptp(away / FORCE.apart @ down))
    if gain > FORCE.pulled and differs > FORCE.pull:
        return f"the object is pulled down by {differs:.1f} N more at one place than at another"
    return ""


def find_external_press(measured: Mapping[str, tuple[float, float, float]], slid: Sequence[TapSlide]) -> str:
    """What presses the object onto the table and is no weight, if all slides end sooner than friction has it; "" for nothing."""
    if len(slid) < SLIDE.least or not {"table", "mass"} <= set(measured):
        return ""
    friction, low, high = (GRAVITY * value for value in measured["table"])
    deviations = [np.hypot(SLIDE.face, (one.short(low) - one.short(high)) / 3.92) for one in slid]
    if min(one.short(friction) / own for one, own in zip(slid, deviations)) < SLIDE.sooner:
        return ""
    # Pushes and drags determine weight and the rest together; of what slows an object by its own weight, mass is no part.
    force = (1 - friction / fit_deceleration(slid)) * measured["mass"][0] * GRAVITY
    return (
        f"about {force:.1f} N of what presses the object onto the table are no weight: it stops sooner when it slides"
    )


def _fit_extra_force(
    used: Sequence[ForceReading], believed: NominalContact, columns: np.ndarray
) -> tuple[np.ndarray, float]:
    """Numbers (2,) by which forces that go with columns (n, 2) are larger, and nats by which readings are more probable with them."""
    force = np.array([r.force for r in used])
    own = np.array([np.hypot(r.deviation, believed.table * r.normal_deviation) for r in used])

    def off(x: np.ndarray) -> np.ndarray:
        left = (force - predict_forces(x[:2], used, believed) - columns @ x[2:]) / np.hypot(own, FORCE.common)
        return np.concatenate([left, x[:2] / UNKNOWN])

    more = least_squares(off, np.zeros(4), loss="soft_l1", f_scale=TAILS)
    without = least_squares(lambda x: off(np.append(x, [0.0, 0.0])), np.zeros(2), loss="soft_l1", f_scale=TAILS)
    return more.x[2:], float(without.cost - more.cost)
