"""The closed loop in the simulator: shots that repeat what was recorded, and refits that find what was
there."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from own_simulator import record
from sim2real.arm.model import panda
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.inference.estimates import Estimate
from sim2real.simulation import refit as refitting
from sim2real.simulation.multiple_shooting import cut_windows, rms, simulate_departures
from sim2real.simulation.refit import RefittedEffect, is_disagreement, refit
from sim2real.thresholds import THRESHOLDS

SHOT = THRESHOLDS.simulation

TRUTH = Patch(
    (
        PatchEffect("coulomb_friction", "panda_joint4", {"level": 0.4}),
        PatchEffect("viscous_friction", "panda_joint4", {"coefficient": 0.3}),
        PatchEffect("command_delay", "arm", {"delay": 0.002}),
    )
)


@pytest.fixture(scope="module")
def log():
    return record(["sinusoid_4"], TRUTH)


@pytest.fixture(scope="module")
def recorded(log):
    return cut_windows([log], every=0.5)


def test_windows_are_stretches_of_the_recording(log, recorded):
    assert len(recorded) >= 5
    assert recorded.position.shape[1:] == (round((SHOT.warm + SHOT.window) / 0.002) + 1, 7)
    first = round(recorded.start[2] / 0.002)
    assert np.array_equal(recorded.position[2], log.position[first : first + recorded.position.shape[1]])
    law = recorded.stiffness * (recorded.lead - recorded.position) - recorded.damping * recorded.velocity
    assert np.allclose(law + recorded.fed, recorded.commanded)
    assert np.diff(recorded.sampled).tolist() == [round(SHOT.sample / 0.002)] * (len(recorded.sampled) - 1)


def test_recordings_without_commands_or_too_short_have_none(log):
    assert cut_windows([replace(log, commands=None)]) is None
    few = replace(
        log.commands,
        **{
            name: getattr(log.commands, name)[:200]
            for name in ("rows", "target", "target_velocity", "torque", "torque_time", "stiffness", "damping")
        },
    )
    assert cut_windows([replace(log, commands=few)]) is None


def test_a_lost_command_ends_a_window(log):
    c = log.commands
    kept = np.arange(len(c.rows)) != 700
    torn = replace(
        c,
        **{
            name: getattr(c, name)[kept]
            for name in ("rows", "target", "target_velocity", "torque", "torque_time", "stiffness", "damping")
        },
    )
    spans = cut_windows([replace(log, commands=torn)], every=0.5).start
    assert not ((spans < 700 * 0.002) & (spans + SHOT.warm + SHOT.window > 700 * 0.002)).any()


def test_with_the_true_effects_a_shot_repeats_the_recording(recorded):
    nominal, true = rms(simulate_departures(recorded, [Patch(), TRUTH]))
    assert nominal[3] > 5e-4 and true[3] < 0.01 * nominal[3]


def test_side_by_side_is_one_by_one(recorded):
    patches = [Patch(), TRUTH, Patch((PatchEffect("payload", "arm", {"mass": 0.3}),))]
    together = simulate_departures(recorded[:2], patches)
    for patch, errors in zip(patches, together):
        assert np.array_equal(simulate_departures(recorded[:2], [patch])[0], errors)


def test_late_and_biased_sensors_are_started_from_what_was_true():
    patch = Patch(
        (
            PatchEffect("measurement_delay", "arm", {"delay": 0.003}),
            PatchEffect("encoder_bias", "panda_joint4", {"bias": 0.01}),
        )
    )
    late = cut_windows([record(["sinusoid_4"], patch)], every=1.0)
    nominal, true = rms(simulate_departures(late, [Patch(), patch]))
    assert true[3] < 0.05 * nominal[3]


def part(effect, component, **values):
    return RefittedEffect(
        effect, component, {name: Estimate(v, v - w, v + w, "") for name, (v, w) in values.items()}, {}
    )


def test_a_refit_finds_the_parameters_from_a_poor_start(recorded):
    done = refit(
        recorded,
        [
            part("coulomb_friction", "panda_joint4", level=(0.3, 0.05)),
            part("viscous_friction", "panda_joint4", coefficient=(0.5, 0.1)),
            part("command_delay", "arm", delay=(0.003, 5e-4)),
        ],
    )
    level, coefficient, delay = (next(iter(v.values())) for v in done.values)
    assert level.value == pytest.approx(0.4, abs=0.01)
    assert coefficient.value == pytest.approx(0.3, abs=0.02)
    assert delay.value == pytest.approx(0.002, abs=5e-5)
    assert done.forward[3] < 0.1 * done.torque_domain[3] < done.nominal[3]
    assert done.fitted + done.held_out == len(recorded)


def test_the_delay_is_a_nuisance_of_every_fit(recorded):
    """What a late loop does is not taken for damping."""
    done = refit(
        recorded,
        [
            part("coulomb_friction", "panda_joint4", level=(0.4, 0.02)),
            part("viscous_friction", "panda_joint4", coefficient=(0.3, 0.05)),
        ],
    )
    assert set(done.values[0]) == {"level"} and set(done.values[1]) == {"coefficient"}
    assert done.values[1]["coefficient"].value == pytest.approx(0.3, abs=0.05)


def test_what_the_simulator_does_not_carry_is_not_refitted(recorded):
    assert refit(recorded, [part("joint_elasticity", "panda_joint4", compliance=(1e-4, 1e-5))]) is None
    assert refit(recorded, []) is None


def test_disagreement_is_beyond_both_intervals():
    one = Estimate(1.0, 0.9, 1.1, "Nm")
    assert is_disagreement(one, Estimate(1.3, 1.2, 1.4, "Nm"))
    assert not is_disagreement(one, Estimate(1.1, 1.0, 1.2, "Nm"))
    assert not is_disagreement(Estimate(1.0, 1.0, 1.0, "Nm"), Estimate(1.01, 1.01, 1.01, "Nm"))  # two simulators differ


def test_a_row_of_the_report_says_where_the_two_disagree(recorded):
    wrong = part("coulomb_friction", "panda_joint4", level=(0.7, 0.02))
    row = refitting._refit_row(refit(recorded, [wrong]), [part("backlash", "panda_joint4", half_play=(1e-4, 1e-5))])
    assert row["not_carried"] == ["backlash at panda_joint4"]
    assert row["parameters"][0]["disagree"] is True
    assert row["closed_loop_rad"]["forward"] < row["closed_loop_rad"]["torque_domain"]
    assert json.loads(json.dumps(row)) == row


def test_a_model_that_no_arm_can_have_is_reported_and_does_not_end_the_report(monkeypatch, log):
    """Inertia below nothing: MuJoCo refuses to make such a link."""
    impossible = RefittedEffect("link_inertia", "panda_joint4", {"scale": Estimate(-1.5, -1.6, -1.4, "1")}, {})
    monkeypatch.setattr(refitting, "effects_to_refit", lambda *_: (impossible,))
    monkeypatch.setattr(refitting, "cut_windows", lambda logs: cut_windows(logs, every=0.5))
    diagnosis = SimpleNamespace(context=SimpleNamespace(arm=panda(), logs=[log]), design=SimpleNamespace(parameters=()))
    (row,) = refitting.refit_in_simulation(diagnosis)["structures"]
    assert row["effects"] == ["link_inertia at panda_joint4"] and row["error"]
