"""Checks of the diagnosis on itself: intervals that include rival structures, patches that were tried, and what is odd.

On recordings of arms whose truth is known: a short one for the torque domain, and bags of the blind test's arms.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from arm_generator import Truth, at, record
from sim2real.arm.model import panda
from sim2real.checks.friction_ageing import _memory, find_friction_ageing
from sim2real.checks.lack_of_fit import _outlying, omnibus_test
from sim2real.diagnosis import explain_gap
from sim2real.effects.stage import Stage
from sim2real.excitation.suite import make_suite
from sim2real.inference.context import make_context
from sim2real.inference.model_averaging import between_model_deviations
from sim2real.inference.ranking import find_generalisations
from sim2real.inference.regression import make_regression
from sim2real.inference.search import ModelSearch, ScoredModel
from sim2real.recordings.reading import load_bag
from sim2real.recordings.signals import GRID
from sim2real.simulation.patch_trial import try_patch
from sim2real.thresholds import THRESHOLDS

from np_blind.arm.bags import write_bag
from np_blind.arm.loop import make_targets, run
from np_blind.arm.plant.physics import nominal_physics
from np_description.panda import NOMINAL

RNG = np.random.default_rng(3)
STUCK, AGEING, DROPPING = 3, 3, 1  # the joints, counted from 0


@pytest.fixture(scope="module")
def stuck():
    """Of an arm with 0.3 N m of Coulomb friction in joint 4: a quick look at 24 s of motion."""
    truth = Truth(coulomb_positive=at(STUCK + 1, 0.3), coulomb_negative=at(STUCK + 1, 0.3))
    return explain_gap([record(truth)], quick=True)


@pytest.fixture(scope="module")
def searches(tmp_path_factory):
    """Of a clean arm, one whose joint 4 sets at rest, and one whose joint 2 has a drive that drops out; from bags."""
    physics = nominal_physics(3)
    physics.ageing[1, AGEING], physics.ageing_time[1, AGEING] = 1.5, 1.0
    physics.dropout[2, DROPPING] = 0.5
    targets = make_targets(make_suite(["dwell", "microstrokes"]))
    recorded = run(physics, targets, [(3, arm) for arm in range(3)])
    found = []
    for arm, name in enumerate(("clean", "sets", "drops out")):
        path = tmp_path_factory.mktemp("bags") / name
        write_bag(path, recorded, arm, targets, 10**9, {})
        found.append(ModelSearch(make_regression(make_context([load_bag(path)], panda()))))
    return found


def number(search, name, joint=STUCK):
    """The candidate of an effect in a joint, of its variant without a name."""
    [found] = [n for n, c in enumerate(search.design.candidates) if c.effect.key == name and c.joint == joint]
    return found


def velocity(*parts):
    """(s, rad/s) one after the other."""
    return np.concatenate([np.full(round(duration / GRID), speed) for duration, speed in parts])


def test_a_rest_is_remembered_by_its_length_and_fades():
    speed = velocity((1.0, 0.1), (0.5, 0.0), (1.0, -0.1), (2.0, 0.0), (1.0, 0.1))
    fresh, aged = _memory(speed + 1e-4 * RNG.normal(size=len(speed)))
    one, two = round(1.55 / GRID), round(4.55 / GRID)  # shortly after either rest
    assert fresh[one] == pytest.approx(-np.exp(-0.05 / THRESHOLDS.standstill.fade), rel=0.2) and fresh[two] > 0.4
    assert aged[two] / fresh[two] > 2 * aged[one] / fresh[one] > 1
    assert np.abs(fresh[: round(1.0 / GRID)]).max() == 0  # it never stood before
    assert abs(fresh[round(2.4 / GRID)]) < 1e-2 and not fresh[round(1.2 / GRID)]


def test_friction_that_ages_at_rest_is_seen(searches):
    assert [find_friction_ageing(search, ()) for search in searches] == [set(), {AGEING}, set()]


def test_noise_never_goes_so_far_and_a_drive_that_drops_out_does(searches):
    clean, _, dropping = (
        {(lack.stage, lack.joint): lack.outlying for lack in omnibus_test(search, ())} for search in searches
    )
    place = ("r1", DROPPING)
    assert max(max(clean[place]), max(dropping["r1", 0])) < 1e-3
    assert min(dropping[place]) > 0.1  # (N m)^2
    noise, dropped = (
        next(c.residual[c.rows] for c in search.design.cells if (c.stage, c.joint) == place)
        for search in (searches[0], searches[2])
    )
    before, after = _outlying(dropped, noise)  # a structure that leaves noise alone has taken all of it away
    assert before > 0.1 and after < 1e-3


def test_an_interval_holds_what_a_rival_structure_says(stuck):
    """Two structures predict nearly alike; their estimates of a parameter differ, and either's interval includes the difference."""
    search = ModelSearch(stuck.design)
    plain, rival = number(search, "coulomb_friction"), number(search, "armature")
    joints, alone, both = (STUCK,), (plain,), (plain, rival)
    assert between_model_deviations(search, joints, alone, plain, 0) == {}  # nothing was scored
    levels = []
    for inside in (alone, both):
        ids = search.ids(joints, inside)
        place = np.flatnonzero(ids == search.design.candidates[plain].ids[0])[0]
        levels.append(search.group(joints, inside)[0].fit.parameters[:, place].mean())
    own, other = (between_model_deviations(search, joints, inside, plain, 0)["level"] for inside in (alone, both))
    assert 0 < own < abs(levels[1] - levels[0]) and other > 0
    assert np.hypot(own, other) == pytest.approx(abs(levels[1] - levels[0]), rel=1e-2)  # their weights add up to one
    # The one contains the other: both together add nothing.
    search = ModelSearch(stuck.design)
    for inside in (alone, (plain, number(search, "asymmetric_coulomb_friction"))):
        search.group(joints, inside)
    assert between_model_deviations(search, joints, alone, plain, 0) == {"level": 0.0}


def test_what_contains_an_effect_is_known_by_its_columns(stuck):
    """Levels for either direction contain one level for both, a slope does not; a free curve contains each."""
    search = stuck.search
    assert find_generalisations(search, number(search, "coulomb_friction")) == (
        "asymmetric_coulomb_friction",
        "friction_curve",
    )
    assert find_generalisations(search, number(search, "viscous_friction")) == (
        "asymmetric_viscous_friction",
        "friction_curve",
    )
    assert find_generalisations(search, number(search, "asymmetric_coulomb_friction")) == ("friction_curve",)


def test_a_patch_that_makes_the_closed_loop_worse_loses_what_does_so(stuck):
    """Beside the friction that is there, an inertia that is not."""
    [friction] = [f for f in stuck.findings if f.is_chosen]
    [(name, level)] = friction.parameters.items()
    assert (friction.effect.id, friction.component, name) == ("coulomb_friction", NOMINAL.joints[STUCK], "level")
    effect = stuck.design.candidates[number(stuck.search, "armature", 1)].effect
    inertia = replace(
        friction, effect=effect, component=NOMINAL.joints[1], parameters={"inertia": replace(level, value=2.0)}
    )
    patch, trial = try_patch(replace(stuck, findings=(inertia, friction)))
    assert [e.effect for e in patch.effects] == ["coulomb_friction"]
    assert trial.left_out == (f"armature at {NOMINAL.joints[1]}",)
    assert trial.after[STUCK] < 0.3 * trial.before[STUCK]
    assert try_patch(replace(stuck, findings=(inertia,)))[0].effects == ()


@pytest.mark.parametrize("effect, matters", [("link_inertia", False), ("presliding_friction", True)])
def test_an_inertia_has_to_matter_in_all_rows_of_a_joint_and_friction_where_it_acts(monkeypatch, effect, matters):
    """.011 Nm in the few rows about reversals, hardly anything in the others."""
    cells = [
        SimpleNamespace(stage=Stage.DYNAMICS, joint=2, at_reversal=at, rows=np.ones(n, bool))
        for at, n in ((False, 9000), (True, 1000))
    ]
    candidate = SimpleNamespace(effect=SimpleNamespace(id=effect, acts=1.0))
    search = ModelSearch(SimpleNamespace(cells=cells, candidates=[candidate], context=None))
    squares = {(): [9000 * 0.02**2, 1000 * 0.024**2], (0,): [9000 * (0.02**2 - 0.003**2), 1000 * (0.024**2 - 0.011**2)]}
    monkeypatch.setattr(ModelSearch, "energies", lambda _, members: squares[members])
    monkeypatch.setattr(ModelSearch, "is_negligible", lambda *_: False)
    monkeypatch.setattr("sim2real.inference.search.noise_floor", lambda *_: 0.0087)
    one, none = (ScoredModel(members, np.zeros(1), 0.0) for members in ((0,), ()))
    assert search.is_material(one, none) is matters
