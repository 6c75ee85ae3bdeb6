"""Effort as what the drives give, and as what a sensor after the gear shows."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arm_generator import Truth, at, record
from sim2real.arm import rigid_body as rigid
from sim2real.arm.model import panda
from sim2real.checks.effort_side import DRIVE, SENSOR, convert_to_drive_side, is_after_gear
from sim2real.recordings.reading import load_log
from sim2real.recordings.signals import Log

from np_description.panda import NOMINAL

REAL = Path(os.environ.get("NP_REAL_DATA", Path(__file__).resolve().parents[3] / "shared" / "real"))
ARM = panda()
# Friction that one joint has too much or not at all is no question of the sensor.
ODD = Truth(coulomb_positive=at(2, -0.3) + at(4, 0.8), coulomb_negative=at(2, -0.3) + at(4, 0.8))


@pytest.fixture(scope="module")
def log():
    return record(ODD, duration=16.0)


def after_gear(log):
    """The same with sensors after the gear, the commands still the drives'."""
    speed = np.array([np.interp(log.torque_time, log.time, v) for v in log.velocity.T]).T
    turn = np.gradient(speed, log.torque_time, axis=0)
    resisting = np.tanh(speed / 0.003) * NOMINAL.frictionloss + speed * NOMINAL.damping + turn * NOMINAL.armature
    return replace(log, torque=log.torque - resisting)


def test_a_drives_torque_is_left_as_it_is(log):
    assert not is_after_gear([log], ARM)
    (same,), arm = convert_to_drive_side([log], ARM, None)
    assert same is log and arm is ARM
    assert convert_to_drive_side([after_gear(log)], ARM, DRIVE)[1] is ARM


@pytest.mark.parametrize("share", [0.0, 0.9])
def test_a_sensor_after_the_gear_sees_no_rotor_and_may_see_friction(log, share):
    """Bearings and cables after the sensor: the public Panda log of Gaz et al. shows friction, and no rotors."""
    own = np.array([np.interp(log.torque_time, log.time, v) for v in log.velocity.T]).T
    friction = np.tanh(own / 0.003) * NOMINAL.frictionloss + own * NOMINAL.damping
    seen = after_gear(log)
    assert is_after_gear([replace(seen, torque=seen.torque + share * friction)], ARM)


def oscillate(frequencies):
    """A log of sinusoids of all joints with these frequencies Hz (f,), measured at the drives."""
    time = np.arange(5000) * 0.002
    omega = 2 * np.pi * np.array(frequencies)[:, None, None]
    angle = omega * time[:, None] + np.arange(7)
    q = NOMINAL.ready + 0.2 * np.sin(angle).sum(axis=0)
    dq = 0.2 * (omega * np.cos(angle)).sum(axis=0)
    ddq = -0.2 * (omega**2 * np.sin(angle)).sum(axis=0)
    torque = rigid.inverse_dynamics(ARM, q, dq, ddq, np.zeros(3)) + np.tanh(dq / 0.003) * ARM.frictionloss
    return Log("sinusoids", time, q, dq, torque + dq * ARM.damping + ddq * ARM.armature, time, False, None)


POSITION_TORQUES = {
    "cable": lambda q: 3.0 * (q - NOMINAL.ready),
    "gravity": lambda q: 0.1 * rigid.gravity_torque(ARM, q),
    "tilt": lambda q: rigid.gravity_torque(ARM, q, np.array([0.5, 0.5, 0.0])),
}


@pytest.mark.parametrize("torque", POSITION_TORQUES.values(), ids=POSITION_TORQUES)
@pytest.mark.parametrize("frequencies", [(0.15, 0.4), (0.25,)], ids=["two_sinusoids", "one_sinusoid"])
def test_torques_by_position_hide_no_rotors(torque, frequencies):
    """In one sinusoid they are in proportion to the rotor's, and friction alone decides."""
    shown = oscillate(frequencies)
    assert not is_after_gear([replace(shown, torque=shown.torque + torque(shown.position))], ARM)
    seen = after_gear(shown)
    assert is_after_gear([replace(seen, torque=seen.torque - torque(seen.position))], ARM)


@pytest.mark.parametrize("torque", POSITION_TORQUES.values(), ids=POSITION_TORQUES)
def test_torques_by_position_are_no_rotors_of_a_sensor_that_sees_friction(torque):
    shown = oscillate((0.15, 0.4))
    friction = np.tanh(shown.velocity / 0.003) * ARM.frictionloss + shown.velocity * ARM.damping
    seen = after_gear(shown)
    assert is_after_gear([replace(seen, torque=seen.torque + friction - torque(seen.position))], ARM)


def test_the_public_panda_log_is_of_sensors_after_the_gear():
    path = REAL / "panda_gaz2019" / "gaz2019_traj1.npz"
    if not path.exists():
        pytest.skip(f"{path} is not there; NP_REAL_DATA names the folder with real recordings")
    assert is_after_gear([load_log(path)], panda(hand=False))


def test_a_sensor_after_the_gear_beside_the_drives_commands_gets_their_friction_back(log):
    shown = after_gear(log)
    assert is_after_gear([shown], ARM)
    (lifted,), arm = convert_to_drive_side([shown], ARM, None)
    assert arm is ARM
    left, before = (np.sqrt(np.mean((x.torque - log.torque) ** 2, axis=0)) for x in (lifted, shown))
    assert (left < 0.2 * before).all()


def test_a_drive_that_closes_its_loop_about_its_sensor_moves_a_rigid_body(log):
    shown, c = after_gear(log), log.commands
    asked = np.vstack([shown.torque[1:], shown.torque[-1:]])
    shown = replace(shown, commands=replace(c, torque=asked, target=c.target + (asked - c.torque) / c.stiffness))
    (same,), arm = convert_to_drive_side([shown], ARM, None)
    assert same is shown and not arm.frictionloss.any() and not arm.armature.any()
    assert not convert_to_drive_side([replace(log, commands=None)], ARM, SENSOR)[1].frictionloss.any()


def test_an_arm_without_nominal_friction_has_no_side(log):
    bare = ARM.rigid_body_only()
    assert convert_to_drive_side([after_gear(log)], bare, None)[1] is bare
