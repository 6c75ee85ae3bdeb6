"""Motion that is laid aside: nothing is fitted to it, what helps there stays, what does not help goes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from arm_generator import Truth, at, record
from sim2real.arm.model import panda
from sim2real.checks.held_out import keep_what_helps, lay_aside
from sim2real.diagnosis import explain_gap
from sim2real.effects.stage import Stage
from sim2real.inference.context import make_context
from sim2real.inference.regression import make_regression
from sim2real.inference.search import ModelSearch
from sim2real.simulation.multiple_shooting import cut_windows

RUBS = Truth(coulomb_positive=at(4, 0.3), coulomb_negative=at(4, 0.3))


@pytest.fixture(scope="module")
def log():
    return record(RUBS, duration=50.0)


@pytest.fixture(scope="module")
def search(log):
    return ModelSearch(make_regression(make_context([log], panda(), laid_aside=lay_aside([log]))))


def number(search, effect, joint):
    return next(n for n, c in enumerate(search.design.candidates) if (c.effect.id, c.joint) == (effect, joint))


@pytest.mark.parametrize("durations", [(170.0,), (40.0, 30.0), (46.0,), (20.0, 4.0, 30.0)])
def test_windows_lie_apart_inside_their_recordings_and_take_a_fifth(durations):
    windows = lay_aside([SimpleNamespace(duration=d) for d in durations])
    for log, begin, end in windows:
        assert 0 < begin < end < durations[log]
    for (log, _, end), (other, begin, _) in zip(windows, windows[1:]):
        assert log < other or end < begin
    assert 0.1 < sum(end - begin for _, begin, end in windows) / sum(durations) < 0.25


def test_of_a_short_recording_nothing_is_laid_aside():
    short, long = SimpleNamespace(duration=24.0), SimpleNamespace(duration=60.0)
    assert lay_aside([short]) == () and lay_aside([short, short])
    assert lay_aside([short, long], reference=1) == lay_aside([long, short], reference=1) == ()
    assert {log for log, _, _ in lay_aside([long, long], reference=1)} == {0, 1}


def test_nothing_is_fitted_to_what_is_laid_aside(search):
    """Garbage in the windows changes no sum that any fit is made of."""
    stages = search.design.stages
    for cell in search.design.cells:
        aside = stages.window_of(cell.stage) >= 0
        assert aside.any() and not cell.rows[aside].any()


def test_garbage_in_the_windows_changes_no_fit(log, search):
    aside = lay_aside([log])
    time = log.time - log.time[0]
    # Half a filter's width within: what is nearer to an edge is smoothed into rows that count.
    inside = np.any([(time > begin + 0.1) & (time < end - 0.1) for _, begin, end in aside], axis=0)
    torque = np.where(inside[log.commands.rows, None], 50.0, log.commands.torque)
    spoilt = replace(log, commands=replace(log.commands, torque=torque))
    other = ModelSearch(make_regression(make_context([spoilt], panda(), laid_aside=aside)))
    for one, two in zip(search.design.cells, other.design.cells):
        if one.stage is Stage.DYNAMICS:
            assert np.allclose(one.residual[one.rows], two.residual[two.rows])
            assert not np.allclose(one.residual, two.residual)


def test_what_is_there_helps_and_what_is_not_goes(search):
    true, made_up = number(search, "coulomb_friction", 3), number(search, "viscous_friction", 5)
    kept, found = keep_what_helps(search, search.model((true, made_up)), seed=0)
    assert kept.members == (true,)
    assert found.effects[true].interval[0] > 0.5 and found.effects[made_up].interval[0] <= 0
    assert found.after_joint[3] < 0.3 * found.before_joint[3]
    assert found.interval[0] < found.reduction < found.interval[1]


def test_without_windows_the_model_stays_as_it_is(log):
    search = ModelSearch(make_regression(make_context([log], panda())))
    chosen = search.model((number(search, "viscous_friction", 5),))
    assert keep_what_helps(search, chosen, seed=0) == (chosen, None)


def test_shots_lie_within_the_windows_laid_aside(log):
    spans = lay_aside([log])
    shots = cut_windows([log], spans=spans)
    length = shots.position.shape[1] * shots.period
    assert len(shots) >= len(spans)
    for start in shots.start:
        assert any(begin <= start and start + length <= end + 2 * shots.period for _, begin, end in spans)


@pytest.mark.slow
def test_more_than_one_cause_at_a_joint_is_partly_explained():
    """Friction of joint 4, and a torque that waves with the angle of joint 2, which no catalogue has."""
    diagnosis = explain_gap([record(replace(RUBS, waviness=at(2, 1.0)), duration=50.0)])
    assert diagnosis.verdict == "partly_explained" and 1 in diagnosis.unexplained
    (friction,) = [f for f in diagnosis.findings if f.is_chosen and f.component == "panda_joint4"]
    assert friction.is_shown_to_help and friction.effect.id == "coulomb_friction"
    assert diagnosis.held_out.interval[0] > 0
