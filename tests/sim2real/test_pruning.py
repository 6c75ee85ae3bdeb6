"""What a model begins with and what it may lose: a search whose models and verdicts are given."""

from types import SimpleNamespace

import numpy as np
import pytest
from sim2real.inference.search import ModelSearch, ScoredModel

ELASTICITY, BACKLASH, DELAY = 0, 1, 2  # of two parameters, one and one
NATS = {(): 0.0, (ELASTICITY,): 270.0, (BACKLASH,): 269.0, (DELAY,): 1950.0}


class Given(ModelSearch):
    """What predicts by 100 nats better beats; what is negligible beats nothing."""

    negligible: tuple[int, ...] = ()
    best: tuple[int, ...] = ()

    def run(self, width, largest):
        return self.model(self.best)

    def model(self, members):
        return ScoredModel(members, np.array([NATS.get(members, 270.0)]), 0.0)

    def rank_candidates(self, parent, count):
        return [DELAY, ELASTICITY, BACKLASH]

    def is_negligible(self, model, member):
        return member in self.negligible

    def predicts_better(self, one, other):
        return not set(one.members) & set(self.negligible) and one.total > other.total + 100


def search(negligible):
    candidates = [
        SimpleNamespace(ids=np.arange(size), effect=SimpleNamespace(id=name, component="arm"), joint=6, place=6)
        for name, size in (("joint_elasticity", 2), ("backlash", 1), ("command_delay", 1))
    ]
    found = Given(SimpleNamespace(candidates=candidates, context=SimpleNamespace(arm=range(7))))
    found.negligible = negligible
    return found


@pytest.mark.parametrize(
    "negligible, left",
    [((DELAY, BACKLASH), (ELASTICITY,)), ((DELAY,), (BACKLASH,)), ((DELAY, ELASTICITY, BACKLASH), ())],
)
def test_what_any_arm_has_takes_no_effects_place(negligible, left):
    """A delay that every loop has predicted by 1,700 nats more than a soft gear, took its place, and was then dropped: `no_gap`."""
    chosen = search(negligible)
    assert chosen.prune(chosen.model((ELASTICITY,))).members == left


@pytest.mark.parametrize(
    "needed, best, background",
    [
        ((0, 1), (), (0, 1)),
        ((1,), (), ()),
        ((), (), ()),
        ((0, 1), (DELAY,), ()),
    ],
)
def test_friction_is_a_background_where_most_joints_need_their_curves(needed, best, background):
    """Of two joints both must need a curve beside the best effects; the first may then have other effects, but no law of friction."""
    names = (("friction_curve", 0), ("friction_curve", 1), ("coulomb_friction", 0), ("torque_ripple", 0))
    candidates = [
        SimpleNamespace(ids=np.arange(2), effect=SimpleNamespace(id=name, component="arm"), joint=joint, place=joint)
        for name, joint in names
    ]
    found = Given(SimpleNamespace(candidates=candidates, context=SimpleNamespace(arm=range(2))))
    found.negligible = tuple({0, 1} - set(needed))
    found.best = best
    found = found.with_background()
    assert found.background == background
    start = ScoredModel(found.background, np.zeros(1), 0.0)
    assert [found.can_extend(start, n) for n in (2, 3)] == [not background, True]
