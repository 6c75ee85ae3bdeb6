"""Friction as it is measured on Frankas: dry friction that falls with speed, is uneven by direction and drifts a little.

Its law is no class of the diagnosis: neither Stribeck's exponential nor levels that do not depend on speed. At joints 5 to 7
dry friction falls by a third to a half between .04 and .15 rad/s; at the others by a sixth at most.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from np_blind.arm.plant.physics import Physics
from np_description.panda import NOMINAL

LEVEL = (0.9, 1.7)  # of the nominal friction, at rest
UNEVEN = 0.25  # greatest share by which the two directions lie off their mean
WRIST = np.arange(7) >= 4
FALL = np.where(WRIST[:, None], (0.45, 0.65), (0.0, 0.2))  # share of the level that is gone at speed, joint by joint
SPEED = (0.06, 0.1)  # rad/s, at which half of the fall has happened
STEEPNESS = (2.0, 3.5)
VISCOUS = (0.6, 1.8)  # of the nominal damping
DRIFT = (-0.03, 0.08)  # share of friction that goes as the joint warms up
WARM_UP = (60.0, 200.0)  # s


def apply_measured_friction(p: Physics, i: int, seed: Sequence[int]) -> None:
    """Give arm i friction of this kind at every joint, before its faults."""
    rng, joints = np.random.default_rng([*seed, 8]), len(NOMINAL.joints)
    level = NOMINAL.frictionloss * rng.uniform(*LEVEL, joints)
    uneven = rng.uniform(-UNEVEN, UNEVEN, joints)
    fall = rng.uniform(*FALL.T, (2, joints))
    for way, share, floor, drop in (
        (1.0, fall[0], p.coulomb_forward, p.fall_forward),
        (-1.0, fall[1], p.coulomb_backward, p.fall_backward),
    ):
        rest = level * (1.0 + way * uneven)
        floor[i], drop[i] = rest * (1.0 - share), rest * share
    p.fall_speed[i] = np.exp(rng.uniform(*np.log(SPEED), joints))
    p.fall_steepness[i] = rng.uniform(*STEEPNESS, joints)
    for viscous in (p.viscous_forward, p.viscous_backward):
        viscous[i] = NOMINAL.damping * rng.uniform(*VISCOUS, joints)
    p.thermal_drop[i] = rng.uniform(*DRIFT, joints)
    p.thermal_time[i] = rng.uniform(*WARM_UP)
