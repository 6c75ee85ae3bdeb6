"""What detector and driver are told of a patch takes its effect away, where it is one of theirs."""

import numpy as np
import pytest
from sim2real.effects.arm_effects import ArmEffects
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.patch import Patch, PatchEffect

from np_control.dynamics import Dynamics
from np_description.camera import CAMERA
from np_description.domains import find_domain, sample_task
from np_evaluation.calibration_corrections import (
    FRICTION_SHARE,
    CompensatedArm,
    CompensatedView,
    SmithPredictor,
    corrections,
)
from np_perception.pose_estimation import project_keypoints
from np_sim_bridge.simulation import Measurement

MOVED = PatchEffect("camera_extrinsics", "camera", {"x": 0.02, "y": -0.015, "turn_z": 0.01})
LATE = PatchEffect("camera_latency", "camera", {"delay": 0.08})
LOAD = PatchEffect("payload", "arm", {"mass": 0.6})
ZERO = PatchEffect("encoder_bias", "panda_joint4", {"bias": 0.03})
OFFSET = PatchEffect("torque_offset", "panda_joint2", {"offset": -6.0})
DELAY = PatchEffect("command_delay", "arm", {"delay": 0.007})
FRICTION = PatchEffect("coulomb_friction", "panda_joint6", {"level": 2.0})
GRIP = PatchEffect("gripper_friction", "contact", {"relative": -0.4})
Q = np.array([0.1, 0.3, -0.1, -2.0, 0.05, 2.2, 0.8])


def test_what_is_nobodys_to_correct_remains():
    told = corrections(Patch((MOVED, LOAD, GRIP)))
    assert told.remaining == Patch((GRIP,)) and told.arm == Patch((LOAD,)) and not told.is_none
    assert np.allclose(np.subtract(told.camera.position, CAMERA.position), [0.02, -0.015, 0.0])
    assert corrections(Patch((GRIP,))).is_none and not corrections(Patch((LATE,))).is_none


@pytest.mark.parametrize("name", ["wall", "bump", "card"])
def test_corners_are_where_the_believed_camera_would_show_them(name):
    domain = find_domain(name)
    for number in range(5):
        pose, _ = sample_task(domain, np.random.default_rng(number))
        true = project_keypoints(domain, pose, CameraEffects(Patch((MOVED,))).camera)
        wanted = project_keypoints(domain, pose)
        view = CompensatedView(corrections(Patch((MOVED,))), domain)
        assert np.abs(true - wanted)[:, :2].max() > 3.0  # px, that were wrong
        assert np.abs(view(true, 0) - wanted).max() < 0.1
        seen = np.zeros((8, 3))  # nothing is found: nothing is made up
        assert np.array_equal(view(seen, 0), seen)


def test_corners_that_come_late_are_carried_on():
    domain, view = find_domain("wall"), CompensatedView(corrections(Patch((LATE,))), find_domain("wall"))
    pose, _ = sample_task(domain, np.random.default_rng(1))
    first, speed = project_keypoints(domain, pose), 30.0  # px/s
    assert np.array_equal(view(first, 0), first)
    second = first + [0.1 * speed, 0, 0]
    assert np.allclose(view(second, 100_000_000), second + [0.08 * speed, 0, 0])
    blind = second * [1, 1, 0]
    assert np.array_equal(view(blind, 200_000_000), blind)


@pytest.mark.parametrize("effects", [(LOAD,), (ZERO,), (OFFSET,), (LOAD, ZERO, OFFSET)])
def test_the_arm_does_what_is_asked_of_it(effects):
    patch = Patch(effects)
    arm, driver = ArmEffects(patch, 0.002), CompensatedArm(corrections(patch))
    position = np.concatenate([arm.sense(Q, np.zeros(7), np.zeros(7))[0], np.zeros(2)])
    read = driver.read(Measurement(0, position, np.zeros(9), np.zeros(9)))
    assert np.allclose(read.position[:7], Q)
    asked = np.linspace(-2, 2, 7)
    given = arm.drive(driver.drive(asked, read.position[:7], np.zeros(7)), Q) + arm.extra(Q, np.zeros(7))
    without = arm.drive(asked, Q) + arm.extra(Q, np.zeros(7))
    assert np.abs(given - asked).max() < 1e-6
    assert np.abs(without - asked).max() > 0.3 or effects == (ZERO,)


def test_where_nothing_is_to_be_corrected_nothing_is_touched():
    driver = CompensatedArm(corrections(Patch()))
    measured = Measurement(0, np.arange(9.0), np.ones(9), np.zeros(9))
    torque = np.linspace(-2, 3, 7)
    assert driver.read(measured) is measured and driver.drive(torque, measured.position[:7], np.ones(7)) is torque
    told = CompensatedArm(corrections(Patch((PatchEffect("torque_offset", "panda_joint2", {"offset": 1.0}),))))
    assert told.read(measured) is not measured and (told.drive(torque, np.zeros(7), np.zeros(7)) != torque).sum() == 1


def test_friction_is_met_along_the_motion_and_never_in_full():
    driver = CompensatedArm(corrections(Patch((FRICTION,))))
    fast, still = np.full(7, 0.5), np.zeros(7)
    more = driver.drive(np.full(7, -3.0), Q, fast) + 3.0
    assert more[5] == pytest.approx(2.0 * FRICTION_SHARE, rel=1e-3) and not np.delete(more, 5).any()
    assert driver.drive(np.full(7, -3.0), Q, still)[5] == pytest.approx(-3.0 - 2.0 * FRICTION_SHARE, rel=1e-3)
    assert driver.drive(still, Q, still)[5] == 0.0


@pytest.mark.parametrize("blocked", [False, True])
def test_the_state_is_foretold_to_when_a_command_acts(blocked):
    """3.5 periods late; a push that nobody knows of; or against a wall, where commands move nothing."""
    dynamics, period, rng = Dynamics(), 0.002, np.random.default_rng(2)
    inverse = np.linalg.inv(dynamics.mass_matrix(Q))
    foretold, commands = SmithPredictor(3.5 * period, dynamics), [np.zeros(7)] * 5
    q, dq, push = Q.copy(), np.zeros(7), np.full(7, 0.4)
    states, said = [], []
    for number in range(200):
        states.append((q.copy(), dq.copy()))
        said.append(foretold(number * 2_000_000, q, dq))
        assert foretold(number * 2_000_000, q, dq) is said[-1]
        command = np.full(7, 1.0) if blocked else np.sin(0.15 * number) + 0.02 * rng.standard_normal(7)
        foretold.give(command)
        commands.append(command)
        acting = (commands[-4] + commands[-5]) / 2
        faster = dq + (0.0 if blocked else inverse @ acting + push) * period
        q, dq = q + (dq + faster) / 2 * period, faster
    for number in range(100, 190):
        ahead = [(a + b) / 2 for a, b in zip(states[number + 3], states[number + 4])]
        errors = [np.abs(a - b).max() for a, b in zip(said[number], ahead)]
        moved = [np.abs(a - b).max() for a, b in zip(states[number], ahead)]
        assert errors[1] < (0.01 if blocked else 0.03 * max(moved[1], 0.3)) and errors[0] < 2e-4
