"""When a joint is left unexplained, of lacks of fit that are given."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sim2real.checks.lack_of_fit import LackOfFit
from sim2real.checks.unexplained import find_lack_of_fit
from sim2real.effects.stage import Stage

from np_description.panda import NOMINAL

ARM = SimpleNamespace(torque_limit=NOMINAL.torque_limit, frictionloss=np.full(7, 0.2))
CONTEXT = SimpleNamespace(arm=ARM, reference=0)
# Of joint 7 with .3 mrad of play: .05 Nm that remembers, of .03 Nm of noise; the flexible model predicts nothing of it.
REMEMBERS = LackOfFit(Stage.DYNAMICS, 6, -80.0, 120.0, 0.86, 0.75, 2.4, 341, 0.03)


def test_what_a_rotor_alone_leaves_is_explained_where_there_is_play_and_nowhere_else():
    assert find_lack_of_fit([REMEMBERS], CONTEXT, set()) == {6}
    assert find_lack_of_fit([REMEMBERS], CONTEXT, {6}) == set()
    assert find_lack_of_fit([REMEMBERS], CONTEXT, {5}) == {6}


@pytest.mark.parametrize("lack", [
    replace(REMEMBERS, gain=900.0, error=90.0, flexible=0.3),  # the flexible model predicts it
    replace(REMEMBERS, stage=Stage.DRIVE, outlying=(0.05, 0.05)),  # the drive does now and then what noise never does
])  # fmt: skip
def test_play_explains_nothing_else(lack):
    assert find_lack_of_fit([lack], CONTEXT, {6}) == {6}
