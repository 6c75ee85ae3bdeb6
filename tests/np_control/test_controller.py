"""The controller in closed loop with MuJoCo, and its rules on targets, states and trajectories."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from controller_tools import PERIOD, READY, SOFT, ZERO, Arm, answers, quintic
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from np_control.controller import Controller, ControllerConfig
from np_control.impedance import DAMPING_RATIO_MAX, STIFFNESS_MAX, STIFFNESS_MIN
from np_control.kinematics import forward_kinematics, pose_distance, solve_ik
from np_control.safety import LIMITS, Reason, Refusal, State
from np_control.trajectory import make_trajectory

BEYOND = 0.00885  # m, from T_E to the end of the fingertips
LATENCY = ControllerConfig.policy_latency_ns


@pytest.mark.parametrize("seed", range(3))
def test_a_trajectory_is_tracked_within_5_mrad_and_ends_at_rest(seed):
    goal = READY + np.random.default_rng(seed).uniform(-0.6, 0.6, 7)
    trajectory = quintic(goal, 1.2)
    arm = Arm(Controller())
    arm.controller.follow(trajectory, 0)
    errors = [arm.step()[1] for _ in range(int(1.7e9) // PERIOD)]
    assert np.abs(errors).max() < 5e-3
    assert np.abs(arm.q - goal).max() < 3e-3 and np.abs(arm.dq).max() < 5e-3
    assert arm.safety.state is State.MOVING and arm.safety.refusals.total == 0


def down_and_up(q, depth, speed=0.04):
    """From joints (7,) rad straight down by `depth` m and up again."""
    position, rotation = forward_kinematics(q)
    joints = [q]
    for share in np.linspace(0, 1, 41)[1:]:
        lower = position - [0, 0, depth * share**3 * (10 - 15 * share + 6 * share**2)]
        joints.append(solve_ik(joints[-1], lower, rotation, iterations=10, damping=0.01))
    way = np.array(joints + joints[-2::-1])
    times = np.linspace(0, 2 * 1.875 * depth / speed, len(way))
    return make_trajectory(times, way, CubicSpline(times, way, bc_type="clamped")(times, 1), LIMITS)


def pressed(arm):
    """N that hand and fingers take from what they touch, all contacts together."""
    model, data, total, wrench = arm.model, arm.data, np.zeros(3), np.zeros(6)
    for number, contact in enumerate(data.contact):
        mine = [model.body_rootid[model.geom_bodyid[geom]] == model.body("panda_link0").id for geom in contact.geom]
        mujoco.mj_contactForce(model, data, number, wrench)
        total += (int(mine[1]) - int(mine[0])) * (contact.frame.reshape(3, 3).T @ wrench[:3])
    return float(np.linalg.norm(total))


@pytest.mark.parametrize(
    "posture",
    [
        pytest.param([-0.3, 0.144, 0.0, -2.603, 0.0, 2.744, 0.485], id="over the line to the tip"),
        # As a touch of the suite once found it: up and down the arm is three times as stiff there.
        pytest.param([-1.396, 0.3, 1.002, -2.573, -0.576, 2.667, 0.897], id="aside"),
    ],
)
def test_a_hand_that_is_held_up_presses_no_harder_than_it_may(posture):
    """Whatever the lead of its target: on a path to 2 cm below the table and up again, which else presses with 110 N and more."""
    over = np.array(posture)
    position, rotation = forward_kinematics(over)
    over = solve_ik(over, [*position[:2], BEYOND + 0.005], rotation, iterations=50, damping=0.01)
    arm = Arm(Controller(), contacts=True, q=over)
    trajectory = down_and_up(over, 0.025)
    arm.controller.follow(trajectory, 0)
    forces, lowest = [], np.inf
    for _ in range(round((trajectory.duration + 0.3) * 1e9) // PERIOD):
        arm.step()
        forces.append(pressed(arm))
        lowest = min(lowest, forward_kinematics(arm.q)[0][2])
    assert lowest > BEYOND - 0.005
    held = np.convolve(forces, np.full(25, 1 / 25), "valid")  # over 50 ms: not the blow by which it is met
    assert LIMITS.press - 3 < held.max() < 40  # N, at which our driver has a Franka stop itself
    assert np.abs(arm.q - over).max() < 5e-3 and forces[-1] == 0


def test_the_same_inputs_give_the_same_torques_bit_for_bit():
    def run():
        arm = Arm(Controller())
        arm.controller.follow(quintic(READY + 0.2, 0.5), 10 * PERIOD)
        return np.array([arm.step()[0].torque for _ in range(300)])

    np.testing.assert_array_equal(run(), run())


@pytest.mark.parametrize("stiffness", [STIFFNESS_MIN, STIFFNESS_MAX])
@pytest.mark.parametrize("ratio", [0.5, DAMPING_RATIO_MAX])
def test_every_corner_of_the_gains_comes_to_rest(stiffness, ratio):
    """No sampled-data oscillation at 500 Hz, at either end of stiffness and damping."""
    arm = Arm(Controller())
    position, rotation = forward_kinematics(READY)
    arm.controller.set_target(0, position + [0.03, -0.04, 0.05], rotation, stiffness, np.full(7, ratio))
    for _ in range(1500):
        arm.step()
    assert np.abs(arm.dq).max() < 0.02
    distance, _ = pose_distance(arm.q, position + [0.03, -0.04, 0.05], rotation)
    assert distance < 0.02  # Coulomb friction over stiffness


def test_a_target_takes_effect_after_the_latency_from_the_joints_it_answers():
    controller = Controller()
    position, rotation = forward_kinematics(READY)
    target = position + [0.0, 0.0, 0.02]
    controller.observe(0, READY, ZERO)
    controller.answer()
    drift = READY.copy()
    for k in range(1, 5):
        drift = drift + 1e-3
        controller.observe(k * PERIOD, drift, ZERO)
        controller.answer()
    controller.set_target(0, target, rotation, *SOFT)
    reference = Controller()
    reference.observe(0, READY, ZERO)
    reference.set_target(0, target, rotation, *SOFT)
    for stamp in range(5 * PERIOD, LATENCY + PERIOD, PERIOD):
        controller.observe(stamp, drift, ZERO)
        reached = controller.answer().position
        assert np.array_equal(reached, READY) == (stamp < LATENCY)
    for stamp in range(PERIOD, LATENCY + PERIOD, PERIOD):
        reference.observe(stamp, READY, ZERO)
    np.testing.assert_array_equal(reached, reference.answer().position)


@pytest.mark.parametrize(
    "reason, change",
    [
        (Reason.NOT_FINITE, dict(position=np.array([0.5, np.nan, 0.1]))),
        (Reason.NOT_FINITE, dict(rotation=np.full((3, 3), np.nan))),
        (Reason.WORKSPACE, dict(position=np.array([0.5, 0.0, -0.3]))),
        (Reason.GAINS, dict(stiffness=STIFFNESS_MAX * 2)),
        (Reason.UNREACHABLE, dict(position=np.array([0.80, 0.50, 0.80]))),
        (Reason.LATE, dict(stamp=-(10**9))),
        (Reason.FUTURE, dict(stamp=10**9)),
    ],
)
def test_each_bad_target_is_refused_and_changes_nothing(reason, change):
    controller = Controller()
    controller.observe(0, READY, ZERO)
    before = controller.answer()
    position, rotation = forward_kinematics(READY)
    target = dict(stamp=0, position=position, rotation=rotation, stiffness=STIFFNESS_MIN, ratio=np.ones(7))
    with pytest.raises(Refusal) as refusal:
        controller.set_target(**(target | change))
    assert refusal.value.reason is reason
    for stamp in range(PERIOD, 2 * LATENCY, PERIOD):
        controller.observe(stamp, READY, ZERO)
        np.testing.assert_array_equal(controller.answer().position, before.position)


def test_targets_must_come_in_order():
    controller = Controller()
    position, rotation = forward_kinematics(READY)
    for stamp in range(0, 10 * PERIOD, PERIOD):
        controller.observe(stamp, READY, ZERO)
        controller.answer()
    controller.set_target(8 * PERIOD, position, rotation, *SOFT)
    with pytest.raises(Refusal, match="older than the one before"):
        controller.set_target(7 * PERIOD, position, rotation, *SOFT)


def test_a_target_under_the_table_is_cut_to_the_floor():
    controller = Controller()
    low = READY + [0, 0.45, 0, -0.25, 0, 0.7, 0]
    controller.observe(0, low, ZERO)
    position, rotation = forward_kinematics(low)
    assert controller.set_target(0, [*position[:2], -0.1], rotation, *SOFT)


@pytest.mark.parametrize(
    "stamp, q",
    [
        (PERIOD, READY + [0, 0, 0, 0.1, 0, 0, 0]),  # a jump
        (10**9, READY + 1e-3),  # a gap
        (-PERIOD, READY + 1e-3),  # another backend
        (0, READY + 1e-2),
    ],
)  # a reset without time passing
def test_a_state_the_arm_cannot_have_reached_is_a_new_beginning(stamp, q):
    controller = Controller()
    assert controller.observe(0, READY, ZERO)
    controller.follow(quintic(READY + 0.3, 1.0), 0)
    controller.answer()
    assert controller.observe(stamp, q, ZERO)
    answer = controller.answer()
    np.testing.assert_array_equal(answer.position, q)
    np.testing.assert_allclose(answer.torque, 0, atol=1e-12)
    controller.observe(stamp + PERIOD, q, ZERO)
    np.testing.assert_array_equal(controller.answer().position, q)  # the trajectory was dropped


def test_a_repeated_state_gets_the_same_answer_and_no_progress():
    controller = Controller()
    controller.observe(0, READY, ZERO)
    controller.observe(PERIOD, READY + 1e-3, ZERO)
    first = controller.answer()
    assert not controller.observe(PERIOD, READY + 1e-3, ZERO)
    assert controller.answer() is first


def test_a_trajectory_from_elsewhere_is_refused():
    controller = Controller()
    with pytest.raises(Refusal, match="no joint state"):
        controller.follow(quintic(READY + 0.1, 1.0))
    controller.observe(0, READY - 0.2, ZERO)
    with pytest.raises(Refusal, match="from the measured position") as refusal:
        controller.follow(quintic(READY + 0.1, 1.0))
    assert refusal.value.reason is Reason.START


@given(st.integers(1, 700), st.sampled_from([Controller.stop, Controller.hold]))
@settings(max_examples=30, deadline=None)
def test_a_trajectory_broken_off_comes_to_rest_on_its_path(moment, break_off):
    """Within `stop_ns`, at a velocity and an acceleration that are those of the joint target."""
    goal, controller = READY + [0.3, -0.2, 0.1, 0.2, -0.3, 0.2, 0.1], Controller(limits=replace(LIMITS, press=np.inf))
    answers(controller, 1)
    controller.follow(quintic(goal, 1.0), 0)
    before = answers(controller, moment)
    break_off(controller)
    break_off(controller)  # a second time changes nothing
    after = answers(controller, 150, first=moment)
    positions = np.array([a.position for a in (*before, *after)])
    velocities = np.array([a.velocity for a in (*before, *after)])
    share = (positions - READY) / (goal - READY)
    np.testing.assert_allclose(share, share[:, :1].repeat(7, axis=1), atol=1e-9)  # the path is a line
    assert (np.diff(share[:, 0]) >= -1e-12).all() and share[-1, 0] <= 1 + 1e-12
    moved = np.diff(positions, axis=0) / (PERIOD * 1e-9)
    np.testing.assert_allclose(moved, (velocities[1:] + velocities[:-1]) / 2, atol=5e-3)
    assert (velocities[moment + 101 :] == 0).all() and (np.diff(positions[moment + 101 :], axis=0) == 0).all()


def test_a_trajectory_that_has_not_begun_is_dropped_by_a_stop():
    controller = Controller()
    answers(controller, 1)
    controller.follow(quintic(READY + 0.1, 1.0), 10 * PERIOD)
    controller.stop()
    np.testing.assert_array_equal(answers(controller, 200)[-1].position, READY)


@pytest.mark.parametrize("break_off", [Controller.stop, Controller.hold])
def test_an_arm_that_was_released_in_motion_is_held_where_it_is_found(break_off):
    controller = Controller()
    answers(controller, 1)
    controller.follow(quintic(READY + 0.1, 1.0), 0)
    answers(controller, 100)
    controller.release()
    break_off(controller)
    np.testing.assert_array_equal(answers(controller, 50, first=100)[-1].position, READY)


def test_a_stop_leaves_a_target_with_its_gains():
    """Stiffer gains would press harder on what the arm leans against."""
    controller = Controller()
    answers(controller, 1)
    position, rotation = forward_kinematics(READY)
    controller.set_target(0, position + [0.02, 0, 0], rotation, *SOFT)
    before = answers(controller, 50)[-1]
    controller.stop()
    after = answers(controller, 50, first=50)[-1]
    np.testing.assert_array_equal(after.position, before.position)
    np.testing.assert_allclose(after.torque, before.torque)


@pytest.mark.parametrize("reason, q, dq", [(Reason.POSITION, 1e308, 0.0), (Reason.VELOCITY, 0.0, -1e300)])
def test_a_state_that_no_arm_can_have_is_refused_and_the_one_before_kept(reason, q, dq):
    """Such numbers are finite, and the law's torque for them is not: it ended the node."""
    controller = Controller()
    controller.observe(0, READY, ZERO)
    before = controller.answer()
    with pytest.raises(Refusal) as refused:
        controller.observe(PERIOD, READY + q, ZERO + dq)
    assert refused.value.reason is reason
    assert controller.stamp == 0 and controller.answer() is before
