"""The numbers of guards, controller and episode: each is changed on purpose only, here and where docs/reference/graph.md names it."""

from dataclasses import asdict

import numpy as np
import pytest

from np_control import controller, external_force, force_watch, impedance, kinematics, realtime_input, ros2_control
from np_control.safety import LIMITS, filter, press
from np_description.domains import CARD
from np_description.panda import NOMINAL
from np_franka import arm, driver
from np_policy import action, observation
from np_policy.episode_config import EpisodeConfig


def check(found, **expected):
    """Arrays and numbers by name; nothing may be left out."""
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_array_equal(found[name], value, err_msg=name)


def test_the_guards():
    check(
        asdict(LIMITS),
        joints=NOMINAL.joints,
        position_lower=NOMINAL.position_lower,
        position_upper=NOMINAL.position_upper,
        velocity=NOMINAL.velocity_limit,
        torque=NOMINAL.torque_limit,
        torque_rate=NOMINAL.torque_rate_limit,
        period_ns=2_000_000,
        speed_fraction=0.8,
        wall_margin=0.05,
        wall_rate=5.0,
        inertia=[0.17, 0.56, 0.138, 0.22, 0.11, 0.12, 0.10],
        workspace_lower=[0.20, -0.50, -0.06],
        workspace_upper=[0.80, 0.50, 0.80],
        workspace_slack=0.10,
        gain_slew=50.0,
        start_tolerance=0.10,
        press=30.0,
        rest_speed=0.05,
        late_periods=3,
        missed_periods=3,
        silence_ns=200_000_000,
    )


def test_what_the_guards_derive_from_them():
    """At every period they use these in place of the limits."""
    assert LIMITS.period == pytest.approx(0.002) and LIMITS.torque_step == pytest.approx(0.002 * LIMITS.torque_rate)
    np.testing.assert_array_equal(LIMITS.cruise, 0.8 * LIMITS.velocity)
    np.testing.assert_array_equal(LIMITS.walls, [NOMINAL.position_lower + 0.05, NOMINAL.position_upper - 0.05])
    np.testing.assert_allclose(LIMITS.speed_slope * 0.8 * LIMITS.velocity, LIMITS.torque)
    np.testing.assert_allclose(LIMITS.retraction, 2 * LIMITS.torque_rate * LIMITS.inertia)


def test_the_gains():
    check(
        {"hold": filter.HOLD_STIFFNESS, "ratio": filter.HOLD_DAMPING_RATIO, "rest": filter.REST_DAMPING},
        hold=[400.0] * 4 + [100.0] * 3,
        ratio=[1.5] * 7,
        rest=[40.0] * 4 + [8.0] * 3,
    )
    check(
        {name: getattr(impedance, name) for name in vars(impedance) if name.isupper()},
        STIFFNESS_MIN=[40.0] * 4 + [10.0] * 3,
        STIFFNESS_MAX=[400.0] * 4 + [100.0] * 3,
        DAMPING_RATIO_MIN=0.5,
        DAMPING_RATIO_MAX=2.0,
    )


def test_the_controller():
    check(
        asdict(controller.ControllerConfig()),
        stiffness=[400.0] * 4 + [100.0] * 3,
        damping_ratio=1.0,
        policy_latency_ns=20_000_000,
        reach_position=0.05,
        reach_angle=0.2,
        largest_gap_ns=200_000_000,
        largest_target_age_ns=500_000_000,
        stop_ns=120_000_000,
    )
    assert (controller.LARGEST_ANGLE, controller.LARGEST_SPEED) == (100.0, 1000.0)
    assert (kinematics.IK_ITERATIONS, kinematics.IK_DAMPING) == (3, 0.03)
    assert realtime_input.HEARTBEAT_NS == 120_000_000 and press.LEVER == 0.25
    assert ros2_control.START_TOLERANCE == external_force.STICTION_SPEED == 0.01
    assert (force_watch.TOUCH, force_watch.STEP) == (3.0, 0.1)


def test_the_driver():
    assert (driver.REST_TIMEOUT, arm.SETTLING) == (2.0, 0.5)


def test_the_episode():
    config = asdict(EpisodeConfig(CARD))
    del config["domain"], config["camera"]
    assert config == dict(
        lockstep=True,
        policy_period=100_000_000,
        pre_timeout=2.0,
        settle=0.3,
        post_timeout=30.0,
        post_blind=1.0,
        success_frames=5,
        success_share=1.0,
        contacts=1,
        min_score=0.3,
        silence=30.0,
        planning=60.0,
        arrival=0.1,
        camera_covariance=None,
    )


def test_the_policys_action_and_observation():
    assert (action.SIZE, action.RATE, action.POSE, action.STIFFNESS) == (20, 10, slice(0, 6), slice(6, 13))
    assert asdict(action.RESIDUAL_LIMITS_INITIAL) == {"position": 0.06, "rotation": 0.1}
    assert asdict(action.RESIDUAL_LIMITS_FINAL) == {"position": 0.02, "rotation": 0.03}
    assert (observation.POST_SIZE, observation.STUDENT_SIZE, observation.GOAL_GAIN) == (79, 32, 5.0)
