"""Joints whose residual the chosen model does not explain: the tests of model adequacy, put together."""

from __future__ import annotations

import numpy as np

from sim2real.checks.friction_ageing import find_friction_ageing
from sim2real.checks.lack_of_fit import LackOfFit
from sim2real.checks.stationarity import find_patterns, find_slipped_encoders, joints_with_play
from sim2real.effects.evidence import Context
from sim2real.effects.stage import Stage
from sim2real.inference.noise_floor import noise_floor
from sim2real.inference.search import ModelSearch, ScoredModel
from sim2real.thresholds import THRESHOLDS

VERDICT = THRESHOLDS.verdict


def find_unexplained_joints(
    search: ModelSearch, chosen: ScoredModel, lack_of_fit: list[LackOfFit], quick: bool = False
) -> tuple[int, ...]:
    """Joints, by number, that any of the tests rejects; quick: without those of patterns in time."""
    context, members = search.design.context, chosen.members
    suspect = [
        find_lack_of_fit(lack_of_fit, context, joints_with_play(search, members)),
        _overexplained(search, chosen),
        _at_bounds(search, chosen),
        find_friction_ageing(search, members),
    ]
    if not quick:
        suspect += [
            {m.joint for m in find_patterns(search, members, lack_of_fit)},
            find_slipped_encoders(search, members),
        ]
    return tuple(sorted(set().union(*suspect)))


def _overexplained(search: ModelSearch, chosen: ScoredModel) -> set[int]:
    """Joints that need more effects than `VERDICT.per_joint`, the arm's own included: so many can describe anything."""
    cells, count = search.design.cells, np.zeros(len(search.design.context.arm), int)
    before, after = np.array(search.energies(())), np.array(search.energies(chosen.members))
    for m in chosen.members:
        less = np.array(search.energies(tuple(n for n in chosen.members if n != m)))
        needed = {c.joint for c, b, a, rise in zip(cells, before, after, less) if rise - a > VERDICT.needed * b}
        count[list(needed)] += 1
    return set(np.flatnonzero(count > VERDICT.per_joint).tolist())


def _at_bounds(search: ModelSearch, chosen: ScoredModel) -> set[int]:
    """Joints at which a linear or nonlinear parameter is at its bound: the best fit is then no explanation."""
    found = set()
    for joints, inside in search.groups(chosen.members):
        ids, fitted = search.ids(joints, inside), search.group(joints, inside)[0].fit.parameters.mean(axis=0)
        for m in inside:
            candidate = search.design.candidates[m]
            places = [int(np.flatnonzero(ids == i)[0]) for i in candidate.ids]
            nonlinear = candidate.effect.nonlinear
            is_beyond = nonlinear is not None and nonlinear.value > nonlinear.upper
            if is_beyond or any(
                abs(fitted[at]) > VERDICT.at_bound * search.design.parameters[i].upper
                for at, i in zip(places, candidate.ids)
                if search.design.parameters[i].name != "share"
            ):
                found |= set(search.joints_affected(candidate)) if candidate.place is None else {candidate.place}
    return found


def find_lack_of_fit(lack_of_fit: list[LackOfFit], context: Context, with_play: set[int]) -> set[int]:
    """Joints at which the chosen model leaves more than noise.

    Either the flexible model predicts it, or it has a memory that the noise of a clean arm has not, or the drive
    now and then does what noise never does. A joint `with_play` turns its rotor alone across it, and then both: that is
    a memory, and explained.
    """
    found = set()
    for left in lack_of_fit:
        least = noise_floor(context, left.stage, left.joint, VERDICT.torque)
        removable = left.chosen - left.flexible
        is_sure = left.gain > max(VERDICT.gain, VERDICT.gain_errors * left.error)
        is_material = removable > left.rows * least**2
        if is_sure and is_material and removable > (1 - VERDICT.explained) * (left.null - left.flexible):
            found.add(left.joint)
        coloured = left.excess > (VERDICT.coloured**2 - 1) * left.white**2
        before, after = left.outlying
        if left.stage is Stage.DRIVE and after > max((1 - VERDICT.explained) * before, left.white**2, least**2):
            found.add(left.joint)
        if (
            left.stage is Stage.DYNAMICS
            and left.joint not in with_play
            and coloured
            and left.excess > least**2
            and left.removed < VERDICT.coloured_explained
        ):
            found.add(left.joint)
    return found
