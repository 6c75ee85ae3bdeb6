"""Each effect of a simulated drive, joint or sensor steps as its equation says."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.arm_effects import ArmEffects
from sim2real.effects.gravity import GravityTorque
from sim2real.effects.hooks import STICTION_SPEED
from sim2real.effects.joint_dynamics.friction_curve import EFFECT, SPEEDS
from sim2real.effects.patch import Patch, PatchEffect

from np_control.dynamics import Dynamics
from np_description.panda import NOMINAL

PERIOD = 0.002
JOINT = "panda_joint3"
at = 2
torques = arrays(float, (30, 7), elements=st.floats(-30, 30))
speeds = arrays(float, 7, elements=st.floats(-1.5, 1.5))
angles = arrays(float, 7, elements=st.floats(-1.0, 1.0)).map(lambda a: NOMINAL.ready + 0.4 * a)


def gap(effect, component=JOINT, **parameters):
    return ArmEffects(Patch((PatchEffect(effect, component, parameters),)), PERIOD)


def driven(model, commands):
    return np.array([model.drive(row, NOMINAL.ready) for row in commands])


@given(torques, angles, speeds)
def test_without_effects_nothing_is_touched(commands, q, dq):
    nothing = ArmEffects(Patch(), PERIOD)
    assert np.array_equal(driven(nothing, commands), commands)
    assert not nothing.extra(q, dq).any()
    for seen, true in zip(nothing.sense(q, dq, commands[0]), (q, dq, commands[0])):
        assert np.array_equal(seen, true)


@given(torques, st.floats(0.0, 0.012))
def test_a_command_acts_after_its_delay(commands, delay):
    model = gap("command_delay", "arm", delay=delay)
    rows = np.arange(len(commands))
    late = np.clip(rows - delay / PERIOD, 0, None)
    expected = np.column_stack([np.interp(late, rows, column) for column in commands.T])
    assert np.allclose(driven(model, commands), expected, atol=1e-9)


@given(st.floats(5e-4, 0.03), st.floats(-10, 10), st.floats(-10, 10))
def test_a_lag_is_first_order_and_a_period_its_mean(lag, before, after):
    model = gap("actuator_lag", time_constant=lag)
    commands = np.vstack([np.full((1, 7), before), np.full((25, 7), after)])
    given_ = driven(model, commands)
    elapsed = np.arange(26) * PERIOD
    # The step comes with the period that begins at elapsed = 0, in row 1.
    mean = np.exp(-elapsed[:-1] / lag) * lag / PERIOD * (1 - np.exp(-PERIOD / lag))
    assert given_[0, at] == pytest.approx(before)
    assert np.allclose(given_[1:, at], after + (before - after) * mean, atol=1e-9)
    assert np.allclose(np.delete(given_, at, axis=1), np.delete(commands, at, axis=1))


@given(torques, st.floats(0.5, 20.0))
def test_a_drive_saturates(commands, limit):
    for values, held in (({}, GravityTorque()(NOMINAL.ready)[at]), ({"gravity_apart": 1.0}, 0.0)):
        expected = commands.copy()
        expected[:, at] = np.clip(expected[:, at] + held, -limit, limit) - held
        assert np.allclose(driven(gap("torque_saturation", limit=limit, **values), commands), expected, atol=1e-12)


@given(torques, st.floats(10.0, 3000.0))
def test_a_drive_follows_no_faster_than_its_rate(commands, rate):
    given_ = driven(gap("torque_rate_limit", limit=rate), commands)[:, at]
    assert (np.abs(np.diff(given_)) <= rate * PERIOD + 1e-9).all()
    # It goes towards what is asked for, as fast as it may, and then stays: of a period the mean.
    torque, fine = commands[0, at], 200
    share = np.arange(fine + 1) / fine
    for now, asked in zip(given_, commands[:, at]):
        path = torque + np.clip(asked - torque, -rate * PERIOD * share, rate * PERIOD * share)
        torque = path[-1]
        assert now == pytest.approx(np.trapezoid(path, share), abs=rate * PERIOD / fine)


@given(torques, st.floats(-0.3, 0.3), st.floats(-2, 2))
def test_scale_and_offset_come_last(commands, scale, offset):
    patch = Patch(
        (
            PatchEffect("torque_scale", JOINT, {"scale": scale}),
            PatchEffect("torque_offset", JOINT, {"offset": offset}),
        )
    )
    given_ = driven(ArmEffects(patch, PERIOD), commands)
    assert np.allclose(given_[:, at], (1 + scale) * commands[:, at] + offset)


@settings(deadline=None, max_examples=20)
@given(st.floats(0.02, 0.5), st.integers(0, 1000))
def test_a_lost_packet_leaves_the_command_before_it_to_all_joints(share, seed):
    commands = np.arange(3000.0)[:, None] + np.zeros(7)
    model = ArmEffects(Patch((PatchEffect("packet_loss", "arm", {"share": share}),)), PERIOD, seed)
    given_ = driven(model, commands)
    lost = given_[:, 0] != commands[:, 0]
    assert (given_ == given_[:, :1]).all() and (given_[1:][lost[1:]] == given_[:-1][lost[1:]]).all()
    assert lost.mean() == pytest.approx(share, abs=4 * np.sqrt(share / 3000))


@given(angles, speeds, st.floats(-1, 1), st.floats(-1, 1))
def test_what_is_uneven_about_friction_is_half_the_difference(q, dq, positive, negative):
    """With the mean, which the rigid-body model has, each direction gets its own level."""
    patch = Patch(
        (PatchEffect("asymmetric_coulomb_friction", JOINT, {"level_positive": positive, "level_negative": negative}),)
    )
    dq[at] = np.copysign(max(abs(dq[at]), 0.1), dq[at])
    mean = 0.5 * (positive + negative)
    direction = np.sign(dq[at])
    resisting = mean * direction - ArmEffects(patch, PERIOD).extra(q, dq)[at]
    assert resisting == pytest.approx((positive if direction > 0 else negative) * direction, abs=1e-9)


@given(angles, speeds, st.floats(-1, 1), st.floats(-1, 1))
def test_uneven_damping_likewise(q, dq, positive, negative):
    extra = gap("asymmetric_viscous_friction", coefficient_positive=positive, coefficient_negative=negative).extra(
        q, dq
    )
    resisting = 0.5 * (positive + negative) * dq[at] - extra[at]
    assert resisting == pytest.approx((positive if dq[at] > 0 else negative) * dq[at], abs=1e-9)


@given(angles, speeds, st.floats(0.05, 1), st.floats(0.02, 0.3))
def test_stribecks_torque_falls_with_speed(q, dq, breakaway, speed):
    extra = gap("stribeck_friction", breakaway=breakaway, speed=speed).extra(q, dq)
    expected = -breakaway * np.tanh(dq[at] / STICTION_SPEED) * np.exp(-((dq[at] / speed) ** 2))
    assert extra[at] == pytest.approx(expected, abs=1e-12) and not np.delete(extra, at).any()


@given(angles, speeds, st.floats(-0.1, 1), st.floats(-0.1, 1), st.floats(-0.05, 1), st.floats(-0.05, 1))
def test_a_friction_curve_has_dry_and_viscous_friction_of_two_ways_as_special_cases(q, dq, dry, other, viscous, slope):
    """At the speeds of the curve's values on; below the first it is level."""
    dq = np.where(abs(dq) < SPEEDS[0], SPEEDS[0], dq)
    values = {f"positive_{1e3 * v:.0f}": dry + viscous * v for v in SPEEDS}
    values |= {f"negative_{1e3 * v:.0f}": other + slope * v for v in SPEEDS}
    model = gap("friction_curve", **values)
    level = EFFECT.modify_rigid_body(NOMINAL, NOMINAL.joints[at], values).frictionloss - NOMINAL.frictionloss
    resisting = level * np.sign(dq) - model.extra(q, dq)
    expected = dry + viscous * dq[at] if dq[at] > 0 else -other + slope * dq[at]
    assert resisting[at] == pytest.approx(expected, abs=1e-4) and not np.delete(resisting, at).any()


@given(angles, st.floats(-3, 3), st.floats(-1, 1), st.floats(-1, 1), st.sampled_from([100.0, 160.0]))
def test_springs_and_ripple_follow_the_angle(q, stiffness, sine, cosine, order):
    still = np.zeros(7)
    assert gap("cable_torque", stiffness=stiffness, offset=sine).extra(q, still)[at] == pytest.approx(
        -stiffness * (q[at] - NOMINAL.ready[at]) - sine, abs=1e-12
    )
    assert gap("torque_ripple", sine=sine, cosine=cosine, order=order).extra(q, still)[at] == pytest.approx(
        -sine * np.sin(order * q[at]) - cosine * np.cos(order * q[at]), abs=1e-9
    )


@given(st.floats(0.05, 1.0), st.floats(0.002, 0.05), st.lists(st.floats(-0.01, 0.01), min_size=2, max_size=60))
def test_friction_that_builds_up_follows_dahl(level, stroke, moves):
    """dF/dx = (Fc - F sgn v) / x0, whose exact solution over a move is an exponential; it never gives
    energy."""
    model, q, work, state = (
        gap("presliding_friction", level=level, stroke=stroke),
        NOMINAL.ready.copy(),
        0.0,
        0.0,
    )
    model.extra(q, np.zeros(7))
    for move in moves:
        q = q + move * (np.arange(7) == at)
        torque = model.extra(q, np.zeros(7))[at]
        before, direction = state, np.sign(move)
        state = direction + (state - direction) * np.exp(-abs(move) / stroke)
        assert torque == pytest.approx(-level * state, abs=1e-9)
        # Work over the move, exactly: the integral of the exponential.
        work += level * (abs(move) - stroke * (1 - direction * before) * (1 - np.exp(-abs(move) / stroke)))
        assert work > -1e-9 and abs(torque) <= level + 1e-12


@settings(deadline=None)
@given(angles, speeds, st.floats(0.005, 0.2))
def test_friction_of_the_load_is_a_share_of_what_the_joint_holds(q, dq, coefficient):
    extra = gap("load_dependent_friction", "panda_joint4", coefficient=coefficient).extra(q, dq)
    held = np.abs(Dynamics().gravity(q)[3])
    assert extra[3] == pytest.approx(-coefficient * held * np.tanh(dq[3] / STICTION_SPEED), abs=1e-6)


def test_friction_drifts_over_its_duration_and_then_stays():
    model = ArmEffects(Patch((PatchEffect("thermal_drift", JOINT, {"change": -0.3, "duration": 1.0}),)), PERIOD)
    dq = np.full(7, 0.4)
    nominal = NOMINAL.frictionloss[at] * np.tanh(0.4 / STICTION_SPEED) + NOMINAL.damping[at] * 0.4
    course = np.array([model.extra(NOMINAL.ready, dq)[at] for _ in range(1000)]) / nominal
    assert np.allclose(course[:500], 0.3 * np.arange(1, 501) / 500) and np.allclose(course[500:], 0.3)
    begun = ArmEffects(
        Patch((PatchEffect("thermal_drift", JOINT, {"change": -0.3, "duration": 1.0}),)), PERIOD, begin=0.5
    )
    assert begun.extra(NOMINAL.ready, dq)[at] == pytest.approx(course[250] * nominal)


@settings(deadline=None, max_examples=20)
@given(angles, st.floats(-0.1, 0.1))
def test_gravity_is_compensated_too_much_or_too_little(q, scale):
    left = gap("gravity_compensation_error", "arm", scale=scale).extra(q, np.zeros(7))
    assert np.allclose(left, scale * Dynamics().gravity(q), atol=1e-6)


@settings(deadline=None, max_examples=20)
@given(angles, st.floats(-0.02, 0.02))
def test_a_biased_encoder_shifts_what_is_read_and_what_is_compensated(q, bias):
    model = gap("encoder_bias", bias=bias)
    shifted = q + bias * (np.arange(7) == at)
    assert np.allclose(model.sense(q, np.zeros(7), np.zeros(7))[0], shifted)
    expected = Dynamics().gravity(shifted) - Dynamics().gravity(q)
    assert np.allclose(model.extra(q, np.zeros(7)), expected, atol=1e-6)


@settings(deadline=None, max_examples=20)
@given(angles, st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
def test_a_tilted_base_leaves_the_torque_of_a_sideways_gravity(q, roll, pitch):
    left = gap("base_tilt", "arm", roll=roll, pitch=pitch).extra(q, np.zeros(7))
    forward = gap("base_tilt", "arm", roll=0.0, pitch=pitch).extra(q, np.zeros(7))
    sideways = gap("base_tilt", "arm", roll=roll, pitch=0.0).extra(q, np.zeros(7))
    assert np.allclose(left, forward + sideways, atol=1e-9)  # linear in gravity
    # Joint 1 turns about the vertical: upright it holds nothing, tilted it does.
    assert abs(Dynamics().gravity(q)[0]) < 1e-9
    assert (abs(left[0]) > 1e-9) or (abs(roll) + abs(pitch) < 1e-6) or np.isclose(left[0], 0.0, atol=1e-3)


@given(arrays(float, (25, 7), elements=st.floats(-1, 1)), st.floats(0.0, 0.012))
def test_old_states_are_old_by_the_delay(states, delay):
    model = gap("measurement_delay", "arm", delay=delay)
    seen = np.array([model.sense(q, 2 * q, np.zeros(7))[:2] for q in states])
    rows = np.arange(len(states))
    expected = np.column_stack(
        [np.interp(np.clip(rows - delay / PERIOD, 0, None), rows, column) for column in states.T]
    )
    assert np.allclose(seen[:, 0], expected, atol=1e-9) and np.allclose(seen[:, 1], 2 * expected, atol=1e-9)


@given(angles, speeds, st.floats(1e-5, 1e-2), st.floats(-0.1, 0.1), st.floats(-1, 1))
def test_encoders_read_in_steps_and_torque_sensors_are_off(q, dq, step, gain, offset):
    angle, speed, _ = gap("encoder_quantisation", step=step).sense(q, dq, np.zeros(7))
    assert abs(angle[at] - q[at]) <= step / 2 + 1e-12 and np.array_equal(speed, dq)
    assert angle[at] / step == pytest.approx(round(angle[at] / step), abs=1e-6)
    _, _, torque = gap("torque_sensor_error", gain=gain, offset=offset).sense(q, dq, 3 * np.ones(7))
    assert torque[at] == pytest.approx(3 * (1 + gain) + offset) and (np.delete(torque, at) == 3).all()


@pytest.mark.parametrize("effect", [r.id for r in ARM_EFFECTS.values() if not r.is_simulated])
def test_what_a_backend_cannot_carry_is_named_and_does_nothing(effect):
    model = gap(effect, **{ARM_EFFECTS[effect].quantities[0].name: 0.01})
    assert model.ignored == (effect,)
    assert (
        np.array_equal(model.drive(np.ones(7), NOMINAL.ready), np.ones(7))
        and not model.extra(NOMINAL.ready, np.ones(7)).any()
    )


@settings(deadline=None, max_examples=30)
@given(
    st.lists(
        st.sampled_from(
            [
                PatchEffect("command_delay", "arm", {"delay": 0.0033}),
                PatchEffect("measurement_delay", "arm", {"delay": 0.0021}),
                PatchEffect("actuator_lag", "panda_joint1", {"time_constant": 0.004}),
                PatchEffect("presliding_friction", JOINT, {"level": 0.3, "stroke": 0.01}),
                PatchEffect("payload", "arm", {"mass": 0.4}),
                PatchEffect("load_dependent_friction", "panda_joint4", {"coefficient": 0.05}),
                PatchEffect("torque_rate_limit", "panda_joint2", {"limit": 80.0}),
                PatchEffect("packet_loss", "arm", {"share": 0.2}),
            ]
        ),
        min_size=2,
        max_size=3,
    ),
    st.integers(0, 100),
)
def test_side_by_side_is_one_by_one(effects, seed):
    rng = np.random.default_rng(seed)
    patches = [Patch((effect,)) for effect in effects]
    together, alone = ArmEffects(patches, PERIOD), [ArmEffects(patch, PERIOD) for patch in patches]
    for _ in range(12):
        command, q, dq = (scale * rng.normal(size=(len(patches), 7)) for scale in (5.0, 0.2, 0.5))
        lost = [e for e in effects if e.effect == "packet_loss"]
        if not lost:
            assert np.allclose(
                together.drive(command, q),
                [one.drive(row, angles) for one, row, angles in zip(alone, command, q)],
                atol=1e-12,
            )
        assert np.allclose(together.extra(q, dq), [one.extra(*row) for one, row in zip(alone, zip(q, dq))], atol=1e-12)
        seen = zip(*(one.sense(*row) for one, row in zip(alone, zip(q, dq, command))))
        for wide, rows in zip(together.sense(q, dq, command), seen):
            assert np.allclose(wide, rows, atol=1e-12)
