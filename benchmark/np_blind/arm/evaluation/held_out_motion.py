"""Motions that no bag shows, for the question how far the gap shrinks: what arms do, without noise."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from sim2real.excitation.motions import Motion, visits, waves
from sim2real.excitation.suite import READY, SCALE, Segment

from np_blind.arm.evaluation.patched_arm import patched_physics
from np_blind.arm.loop import Targets, make_targets, run_stable_arms
from np_blind.arm.plant.physics import Physics, stack
from np_blind.arm.sampling.cases import ArmCase, make_physics
from np_control.impedance import STIFFNESS_MAX

LOST = 1.0  # rad
_SEED = 20261121
_GAINS = np.stack([STIFFNESS_MAX, np.ones(7)])


@cache
def heldout_targets() -> Targets:
    """Eight seconds of waves unlike the suite's, then moves from point to point as a task has them."""
    rng = np.random.default_rng(_SEED)
    frequency = rng.uniform([[0.1], [0.4], [0.9]], [[0.35], [0.8], [1.3]], (3, 7))
    amplitude = 0.22 * SCALE * np.array([[1.0], [0.5], [0.2]])
    duration, moves = visits([0.35 * SCALE * rng.uniform(-1, 1, 7) for _ in range(4)], 0.8, 0.4)
    parts = ((8.0, waves(8.0, amplitude, frequency, rng.uniform(0, 2 * np.pi, (3, 7)))), (duration, moves))
    return make_targets([_segment(f"heldout_{k}", *part) for k, part in enumerate(parts)])


def motions(physics: Physics, targets: Targets) -> np.ndarray:
    """Measured positions (n, B, 7) rad of the arms, sensors without noise, from the first target on.

    An arm that runs away, as a wrong patch may make it, is LOST rad off its targets.
    """
    position = np.tile(targets.position[targets.first :, None] + LOST, (1, len(physics), 1))
    record, staying, _ = run_stable_arms(physics, targets, None)
    if record is not None:
        position[:, staying] = record.position[targets.first :]
    return position


def gaps(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """RMS difference (B,) rad, over time and joints, of motions (n, B, 7)."""
    return np.sqrt(((one - other) ** 2).mean(axis=(0, 2)))


def heldout_gaps(cases: Sequence[ArmCase], patches: Sequence[list[dict]]) -> list[tuple[float, float, float]]:
    """For each case, gaps rad of the nominal arm, of the nominal arm with the true faults, and of the patched
    one.

    Each against the arm itself, its background included, without sensor noise. A patch whose arm cannot be
    computed is LOST rad off.
    """
    try:
        return _heldout_gaps(cases, patches)
    except (ArithmeticError, np.linalg.LinAlgError):
        if len(cases) > 1:  # one of them spoils the others
            return [gap for case, patch in zip(cases, patches) for gap in heldout_gaps([case], [patch])]
        ((nominal, oracle, _),) = _heldout_gaps(cases, [[]])
        return [(nominal, oracle, LOST)]


def _heldout_gaps(cases: Sequence[ArmCase], patches: Sequence[list[dict]]) -> list[tuple[float, float, float]]:
    clean = [ArmCase(case.number, "null", (), case.seed) for case in cases]
    arms = [
        make_physics(list(cases))[0],
        make_physics(clean, background=False)[0],
        make_physics(list(cases), background=False)[0],
        patched_physics(list(patches)),
    ]
    truth, *others = np.split(motions(stack(arms), heldout_targets()), len(arms), axis=1)
    return [tuple(map(float, row)) for row in zip(*(gaps(other, truth) for other in others))]


def _segment(name: str, duration: float, motion: Motion) -> Segment:
    times = np.linspace(0.0, duration, int(np.ceil(duration * 50)) + 1)
    offset, velocity = motion(times)
    return Segment(name, times, READY + offset, velocity, _GAINS)
