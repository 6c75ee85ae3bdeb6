"""What every arm of the blind test has besides its faults.

It is wider than the nuisances of the diagnosis on purpose, and not their mirror image.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from np_blind.arm.plant.physics import Physics

INERTIA_ERROR = 0.03  # standard deviation, of each link's inertia
DELAY = 4e-4  # s, greatest of the background
MASS_ERROR = 0.03  # standard deviations, of each link's mass, and of its centre in its distance from the joint
WIDE_DELAY = 1e-3  # s
WAVES = 0.1  # greatest share of friction that comes and goes with the angle
HOLDING = 0.1  # greatest share of friction that is there on top at standstill
CREEP = 4e-4  # rad, greatest over which a joint creeps before it slides
DRIVE_NOISE = 0.02  # Nm, of a period's torque
# Between two days, though nothing has changed, at most:
DAY_FRICTION = 0.02  # share of each joint's friction
DAY_DELAY = 1e-4  # s
DAY_NOISE = 0.1  # share of the noise of sensors and drives


def apply_background(physics: Physics, arm: int, seed: Sequence[int], ready: np.ndarray) -> None:
    """Give an arm the background of its seed, before its faults. ready (k,) rad: its usual posture."""
    rng, joints = np.random.default_rng([*seed, 0]), physics.inertials.mass.shape[1]
    errors, delay = rng.normal(size=joints), rng.uniform(0.0, DELAY)
    breakaway, noise = np.exp(rng.uniform(np.log(3e-5), np.log(2e-4), joints)), rng.uniform(0.7, 1.4)
    physics.inertials.inertia[arm] *= (1.0 + INERTIA_ERROR * errors)[:, None, None]
    physics.command_delay[arm], physics.breakaway[arm], physics.noise[arm] = delay, breakaway, noise
    _widen(physics, arm, np.random.default_rng([*seed, 4]), ready)


def _widen(p: Physics, i: int, rng: np.random.Generator, ready: np.ndarray) -> None:
    links, joints = p.inertials, p.inertials.mass.shape[1]
    heavier = 1.0 + MASS_ERROR * rng.normal(size=joints)
    away = np.linalg.norm(links.com[i], axis=1)[:, None]
    links.mass[i] *= heavier
    links.inertia[i] *= heavier[:, None, None]
    links.com[i] += MASS_ERROR * away * rng.normal(size=(joints, 3))
    # Its maker weighed the arm as it is: what its drives compensate is its own weight, without what comes later.
    p.compensated.mass[i], p.compensated.com[i] = links.mass[i], links.com[i]
    p.command_delay[i] = rng.uniform(0.0, WIDE_DELAY)
    p.breakaway[i] = np.exp(rng.uniform(np.log(3e-5), np.log(CREEP), joints))
    p.uneven[i], p.uneven_order[i] = rng.uniform(0.0, WAVES, joints), rng.integers(1, 4, joints)
    # About the ready posture friction has its stated value: elsewhere it is more or less.
    p.uneven_phase[i] = np.pi * rng.integers(0, 2, joints) - p.uneven_order[i] * ready
    p.holding[i] = rng.uniform(0.0, HOLDING, joints)
    p.drive_noise[i] = rng.uniform(0.0, DRIVE_NOISE)


def apply_session_changes(p: Physics, i: int, seed: Sequence[int]) -> None:
    """What is different in an arm on the second day of a set of changes though nothing has changed."""
    rng = np.random.default_rng([*seed, 7])
    coulomb, viscous = 1.0 + rng.uniform(-DAY_FRICTION, DAY_FRICTION, (2, p.inertials.mass.shape[1]))
    p.coulomb_forward[i] *= coulomb
    p.coulomb_backward[i] *= coulomb
    p.viscous_forward[i] *= viscous
    p.viscous_backward[i] *= viscous
    p.command_delay[i] = max(p.command_delay[i] + rng.uniform(-DAY_DELAY, DAY_DELAY), 0.0)
    for noise in (p.noise, p.drive_noise):
        noise[i] *= rng.uniform(1.0 - DAY_NOISE, 1.0 + DAY_NOISE)
