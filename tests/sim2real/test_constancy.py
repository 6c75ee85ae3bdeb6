"""What is nearly an effect of the catalogue, and not one, is found out: its size changes, or it leaves a shape."""

from dataclasses import replace

import numpy as np
import pytest
from arm_generator import PERIOD, Truth, record
from sim2real.arm import rigid_body as rigid
from sim2real.arm.model import panda
from sim2real.arm.nominal_prediction import predict_expected_torque
from sim2real.checks.lack_of_fit import omnibus_test
from sim2real.checks.stationarity import _has_slipped, find_patterns, measure_misfits
from sim2real.diagnosis import diagnose
from sim2real.effects.recurrences import bristle_state
from sim2real.effects.transmission import transmission_hysteresis as transmission
from sim2real.inference import estimates
from sim2real.inference.context import make_context
from sim2real.inference.regression import make_regression
from sim2real.inference.search import ModelSearch
from sim2real.recordings.signals import Log
from sim2real.report.document import make_report
from sim2real.report.page import render

HYSTERESIS = "transmission_hysteresis"
JOINT = 2  # counted from 0: the third


@pytest.fixture(scope="module")
def log():
    clean = record(Truth(), duration=24.0, name="clean")
    rng = np.random.default_rng(5)
    return replace(clean, motor=clean.position + 1e-5 * rng.normal(size=clean.position.shape))


def question_columns(log, scale):
    """The log of an arm one joint of which gives `scale` times what it is asked for."""
    commands = log.commands.torque.copy()
    commands[:, JOINT] /= scale
    return replace(log, commands=replace(log.commands, torque=commands))


def left_of(log, effect, joint=JOINT):
    """(question, joint) of what stands out beside this one effect; of a clean arm's where it is None."""
    search = ModelSearch(make_regression(make_context([log], panda())))
    places = enumerate(search.design.candidates)
    members = tuple(n for n, c in places if c.effect.key == effect and c.joint == joint)
    assert len(members) == (effect is not None)
    return {(m.question, m.joint) for m in find_patterns(search, members, omnibus_test(search, members))}


def swinging(log, inertia, hertz, damping=0.1):
    """Torque (n,) Nm of a part on a spring, that a joint carries along."""
    natural, angle, speed = 2 * np.pi * hertz, log.position[0, JOINT], log.velocity[0, JOINT]
    torque = []
    for q, dq in zip(log.position[:, JOINT], log.velocity[:, JOINT]):
        per_inertia = natural**2 * (q - angle) + 2 * damping * natural * (dq - speed)
        speed += PERIOD * per_inertia
        angle += PERIOD * speed
        torque.append(inertia * per_inertia)
    return np.array(torque)


def lively():
    """A log without commands, of the nominal arm moving at .3 to 2.5 Hz."""
    rng, time = np.random.default_rng(8), np.arange(12_000) * PERIOD
    omega = 2 * np.pi * rng.uniform(0.3, 2.5, (3, 7))
    angle = omega * time[:, None, None] + rng.uniform(0, 2 * np.pi, (3, 7))
    q = panda().rest + (0.3 / omega * np.sin(angle)).sum(axis=1)
    dq, ddq = 0.3 * np.cos(angle).sum(axis=1), -0.3 * (omega * np.sin(angle)).sum(axis=1)
    torque = predict_expected_torque(q, dq, ddq, panda(), True) + 0.02 * rng.normal(size=q.shape)
    return Log("lively", time, q, dq, torque, time, True)


@pytest.mark.parametrize("fades", [False, True])
def test_a_torque_scale_that_fades_is_no_torque_scale(log, fades):
    scale = 1 - 0.08 * (1 - np.exp(-log.time / 10.0)) if fades else 0.94
    found = left_of(question_columns(log, scale), "torque_scale[gravity apart]")
    assert (("size", JOINT) in found) == fades and {joint for _, joint in found} <= {JOINT}


@pytest.mark.parametrize("is_loose", [False, True])
def test_a_part_that_swings_after_its_link_is_no_rotor(is_loose):
    log = lively()
    extra = swinging(log, 0.2, 2.0) if is_loose else 0.2 * np.gradient(log.velocity[:, JOINT], PERIOD)
    torque = log.torque.copy()
    torque[:, JOINT] += extra
    found = left_of(replace(log, torque=torque), "armature")
    assert (("memory", JOINT) in found) == is_loose and {joint for _, joint in found} <= {JOINT}


@pytest.mark.parametrize("amplitude", [0.0, 1e-3])
def test_an_encoder_off_its_centre_shows_against_the_motors(log, amplitude):
    motor = log.motor.copy()
    motor[:, JOINT] -= amplitude * np.sin(log.position[:, JOINT] + 1.0)
    found = left_of(replace(log, motor=motor), None)
    assert found == ({("twist", JOINT)} if amplitude else set())


def test_a_drift_that_is_named_may_change_with_time(log):
    """Elsewhere a size is asked for in r1 and r2."""
    search = ModelSearch(make_regression(make_context([log], panda())))
    numbers = {c.effect.key: n for n, c in enumerate(search.design.candidates) if c.joint == JOINT}
    drift = next(n for key, n in numbers.items() if key.startswith("thermal_drift"))
    for members, stages in (((numbers["viscous_friction"],), {"r2"}), ((numbers["viscous_friction"], drift), set())):
        assert {m.stage for m in measure_misfits(search, tuple(sorted(members))) if m.question == "size"} == stages


def wound_up(log, width, stroke, shaken=0.0):
    """(log with the motor's angles, twist (n,) rad) of a gear with hysteresis at one joint; shaken: rad/s to and fro besides."""
    stiffness = 1e5
    load = np.interp(
        log.time,
        log.time[::10],
        rigid.inverse_dynamics(
            panda(), log.position[::10], log.velocity[::10], np.gradient(log.velocity, PERIOD, axis=0)[::10]
        )[:, JOINT],
    )
    twist, bent, found = 0.0, 0.0, []
    for torque in load:  # K (twist + width z) = torque, quasi-static
        moved = (torque - stiffness * (twist + width * bent)) / stiffness
        moved /= 1 + width / stroke * (1 - np.sign(moved) * bent)
        bent += (moved - np.hypot(moved, shaken * PERIOD) * bent) / stroke
        twist += moved
        found.append(twist)
    motor = log.position + 1.4e-5 * np.random.default_rng(2).normal(size=log.position.shape)
    motor[:, JOINT] += found
    return replace(log, motor=motor), np.array(found)


def hysteresis_of(log):
    """(its regressor, its parameters) where nothing but hysteresis at the joint explains a log."""
    search = ModelSearch(make_regression(make_context([log], panda())))
    members = [n for n, c in enumerate(search.design.candidates) if (c.effect.id, c.joint) == (HYSTERESIS, JOINT)]
    chosen = max((search.model((n,)) for n in members), key=search.value)
    return estimates.estimate(search, chosen, chosen.members[0], seed=0)


@pytest.mark.parametrize("shaken", [1e-5, 2e-5, 4e-5])
def test_an_interval_of_hysteresis_covers_gears_that_noise_shakes_more_or_less(shaken):
    """How fast cannot be seen, and none of these is a speed that the search tries."""
    true = {"width": 1.5e-4, "stroke": 2e-4}
    _, found = hysteresis_of(wound_up(lively(), **true, shaken=shaken)[0])
    assert all(found[name].low <= value <= found[name].high for name, value in true.items())


def test_the_report_gives_no_width_below_zero():
    true = {"width": 4e-4, "stroke": 2e-4}
    log, _ = wound_up(lively(), **true, shaken=2e-5)
    diagnosis = diagnose([log])
    report = make_report(diagnosis, [log], 0.0)
    found = next(e for e in report["effects"] if e["is_added"])
    assert found["effect"] == HYSTERESIS
    for name, value in true.items():
        low, high = found["parameters"][name]["ci95"]
        assert low == 0.0 < value < high
    assert "mrad (95 %: 0.0 to 1.2)" in report["sentence"]
    assert all(f"{name} {found['parameters'][name]['value']:.3g} [0, " in diagnosis.summary() for name in true)
    table = " ".join(render(report, diagnosis).split("<h2>Which</h2>")[1].split("</table>")[0].split())
    assert table.count("(0 to 0.0") == 2


def test_an_interval_of_hysteresis_holds_those_of_all_speeds_that_fit_as_well(monkeypatch):
    log, _ = wound_up(lively(), 1.5e-4, 2e-4, shaken=2e-5)
    monkeypatch.setattr(estimates, "between_model_deviations", lambda *_: {})
    effect, found = hysteresis_of(log)
    monkeypatch.setattr(transmission, "RIVALS", ())
    _, alone = hysteresis_of(log)
    assert effect.nonlinear.value == found["stroke"].value
    for name, one in alone.items():
        assert found[name].low <= one.low and one.high <= found[name].high
        assert found[name].high - found[name].low > one.high - one.low


@pytest.mark.parametrize("factor", [0.5, 2.0, 4.0])
def test_a_gear_that_is_shaken_fast_shows_no_size_of_width_and_stroke(factor):
    """Width, stroke and speed of shaking times a factor wind up the same torque: an interval has to cover them all."""
    moved, stroke, shaken = 1e-9 * np.random.default_rng(3).normal(size=4000), 2e-4, 1e-7
    torque = bristle_state(moved, stroke, shaken)
    np.testing.assert_allclose(
        factor * bristle_state(moved, factor * stroke, factor * shaken), torque, atol=5e-3 * torque.std()
    )


@pytest.mark.parametrize("width", [0.0, 1e-4])
def test_hysteresis_shows_that_winds_up_by_less_than_the_noise_of_the_encoders(width):
    """A twist of some tens of urad, in encoders of 10 urad: what winds it up is known from the load."""
    stroke = 2e-4
    log, found = wound_up(lively(), width, stroke)
    context = make_context([log], panda())
    effect = next(e for e in transmission.EFFECT.regressors(context) if e.key == "transmission_hysteresis[0.2 mrad]")
    straight = np.column_stack([np.ones(len(context.samples)), context.transmission.load[:, JOINT]])
    y = context.transmission.twist[:, JOINT]
    squares = [
        np.square(y - a @ np.linalg.lstsq(a, y, rcond=None)[0]).sum()
        for a in (straight, np.column_stack([straight, effect.columns["r3"](context, JOINT)]))
    ]
    assert np.abs(found).max() < 2 * stroke
    gain = 0.5 * len(y) * np.log(squares[0] / squares[1])
    assert gain > 30 if width else gain < 8


@pytest.mark.parametrize("shift, found", [(0.0, False), (4e-4, True), (2e-5, False)])
def test_a_disc_that_slips_shifts_an_encoder_at_once_and_for_good(shift, found):
    time, rng = np.arange(0.0, 100.0, 0.04), np.random.default_rng(0)
    left = 3e-6 * rng.normal(size=len(time)) + shift * (time > 6.6)
    assert _has_slipped(left, time, np.zeros(len(time), int)) == found


@pytest.mark.parametrize(
    "left",
    [
        lambda t: 2e-4 * np.sign(np.sin(t)),  # a play that is crossed again and again
        lambda t: 3e-4 * np.tanh((t - 50.0) / 1.0),  # another posture, to which it moves
        lambda t: 1e-3 * (np.abs(t - 50.0) < 0.1),  # comes back
    ],
)
def test_what_is_no_slip_is_none(left):
    time, rng = np.arange(0.0, 100.0, 0.04), np.random.default_rng(0)
    assert not _has_slipped(left(time) + 3e-6 * rng.normal(size=len(time)), time, np.zeros(len(time), int))
