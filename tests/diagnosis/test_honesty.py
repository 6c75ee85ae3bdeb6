"""What keeps the doctor honest: intervals that know rival models, patches that were tried, and what no effect explains."""

from types import SimpleNamespace

import numpy as np
import pytest

from np_description.panda import NOMINAL
from np_diagnosis.checks.omnibus import _outlying
from np_diagnosis.checks.standstill import _memory, ageing
from np_diagnosis.effects.base import Effect, Parameter
from np_diagnosis.inference.averaging import spread
from np_diagnosis.inference.design import Candidate
from np_diagnosis.inference.fit import Fit, Score
from np_diagnosis.inference.ranking import generalisations
from np_diagnosis.recordings.signals import GRID
from np_diagnosis.simulation import patching
from np_diagnosis.simulation.patching import tried_patch
from np_diagnosis.thresholds import THRESHOLDS
from np_effects.stage import Stage

RNG = np.random.default_rng(3)


def effect(name, *parameters):
    return Effect(name, tuple(Parameter(p, "Nm", -1.0, 1.0, 1.0) for p in parameters), {}, "test")


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


def search_of(residual, rows, samples):
    """A search without any effect, of one joint whose residual at reversals, the `rows`, is this."""
    cell = SimpleNamespace(
        stage=Stage.DYNAMICS,
        at_reversal=True,
        joint=0,
        rows=rows,
        residual=residual,
        ids=np.zeros(0, int),
        block=np.zeros(len(residual), int),
        matrix=np.zeros((len(residual), 0)),
    )
    arm = SimpleNamespace(torque_limit=np.array([87.0]))
    design = SimpleNamespace(cells=(cell,), context=SimpleNamespace(arm=arm, samples=samples))
    fit = SimpleNamespace(parameters=np.zeros((1, 0)))
    return SimpleNamespace(
        design=design,
        groups=lambda members: [((0,), ())],
        ids=lambda *_: np.zeros(0, int),
        group=lambda *_: (SimpleNamespace(fit=fit), 0.0),
    )


@pytest.mark.parametrize("level, found", [(0.0, set()), (0.3, {0})])
def test_friction_that_ages_at_rest_is_seen(level, found):
    rests = RNG.uniform(0.1, 3.0, 30)
    speed = velocity(*(part for n, rest in enumerate(rests) for part in ((0.4, 0.1 * (-1) ** n), (rest, 0.0))))
    samples = SimpleNamespace(
        segments=[(np.zeros((len(speed), 1)), speed[:, None])], filter=lambda parts: parts[0][::20]
    )
    _, aged = _memory(speed)
    residual = 0.02 * RNG.normal(size=len(aged[::20])) + level * aged[::20]
    assert ageing(search_of(residual, speed[::20] != 0, samples), ()) == found


def test_noise_never_goes_so_far_and_a_drive_that_drops_out_does():
    noise = RNG.normal(size=50_000)
    assert _outlying(noise, noise) == (0.0, 0.0)
    dropped = noise + np.where(RNG.random(50_000) < 0.03, 8.0, 0.0)
    before, after = _outlying(dropped, noise)
    assert before > 1.0 and after == 0.0 and _outlying(dropped, dropped)[1] > 1.0


def test_an_interval_holds_what_a_rival_model_says():
    """Two models predict alike; one puts half of a parameter into another effect."""
    candidates = [
        Candidate(effect("coulomb_friction", "level"), 0, np.array([0])),
        Candidate(effect("viscous_friction", "coefficient"), 0, np.array([1])),
    ]
    cell = SimpleNamespace(ids=np.arange(2), total=np.array([[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    blocks = RNG.normal(size=20)
    values = {(0,): np.array([1.0]), (0, 1): np.array([0.5, 3.0]), (): np.zeros(0)}

    def group(joints, inside):
        parameters = np.tile(values[inside], (20, 1))
        return Score(blocks - (1e6 if inside == () else 0.0), Fit(parameters, None, None)), 0.0

    search = SimpleNamespace(
        design=SimpleNamespace(candidates=candidates, cells=(cell,)),
        scored=lambda joints: list(values),
        group=group,
        group_value=lambda joints, inside: float(group(joints, inside)[0].density.sum()),
        ids=lambda joints, inside: np.concatenate([np.zeros(0, int), *(candidates[m].ids for m in inside)]),
    )
    assert spread(search, (0,), (0,), 0, 0) == {"level": pytest.approx(np.sqrt(0.5) * 0.5)}
    cell.total[0, 1] = cell.total[1, 0] = 1.0  # the one can say what the other says: nothing is learnt from both
    assert spread(search, (0,), (0,), 0, 0) == {"level": 0.0}


def test_what_contains_an_effect_is_known_by_its_columns():
    """Levels for either direction contain one level for both; a slope does not."""
    direction = np.sign(RNG.normal(size=400))
    columns = np.column_stack([direction, direction > 0, -1.0 * (direction < 0), RNG.normal(size=400), np.ones(400)])
    cell = SimpleNamespace(ids=np.arange(5), total=np.pad(columns.T @ columns, ((0, 1), (0, 1))))
    candidates = [
        Candidate(effect("coulomb_friction", "level"), 0, np.array([0])),
        Candidate(effect("asymmetric_coulomb_friction", "level_positive", "level_negative"), 0, np.array([1, 2])),
        Candidate(effect("cable_torque", "stiffness", "offset"), 0, np.array([3, 4])),
    ]
    search = SimpleNamespace(design=SimpleNamespace(candidates=candidates, cells=(cell,)))
    assert generalisations(search, 0) == ("asymmetric_coulomb_friction",)
    assert generalisations(search, 1) == ()
    cell.total[3:5] = cell.total[:, 3:5] = 0.0  # what does not show at all says nothing
    assert generalisations(search, 0) == ("asymmetric_coulomb_friction",)


def finding(name, joint):
    return SimpleNamespace(
        effect=SimpleNamespace(id=name, constants={}),
        component=NOMINAL.joints[joint],
        is_chosen=True,
        parameters={"value": SimpleNamespace(value=1.0)},
    )


def test_a_patch_that_makes_the_closed_loop_worse_loses_what_does_so(monkeypatch):
    """Departures are made up: either effect has its own share in them."""
    harm = {"armature": 0.5, "coulomb_friction": -0.4}

    def departures(recorded, patches):
        return np.array([np.full(7, 1.0 + sum(harm[e.effect] for e in patch.effects)) for patch in patches])

    monkeypatch.setattr(patching, "_departures", departures)
    monkeypatch.setattr("np_diagnosis.simulation.forward.windows", lambda logs: object())
    context = SimpleNamespace(arm=SimpleNamespace(joints=NOMINAL.joints), logs=())
    both = SimpleNamespace(
        findings=(finding("armature", 1), finding("coulomb_friction", 2)), unexplained=(), context=context
    )
    patch, left_out, table = tried_patch(both)
    assert [e.effect for e in patch.effects] == ["coulomb_friction"] and left_out == [
        f"armature at {NOMINAL.joints[1]}"
    ]
    assert table[NOMINAL.joints[0]] == {"before": 1.0, "after": pytest.approx(0.6)}
    one = SimpleNamespace(findings=both.findings[:1], unexplained=(), context=context)
    assert tried_patch(one)[0].effects == ()
