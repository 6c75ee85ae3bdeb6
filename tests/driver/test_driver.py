"""The library half of the driver, cycle by cycle, against a simulated robot."""

import time
from dataclasses import replace
from datetime import timedelta
from functools import partial

import numpy as np
import pytest

from np_control.controller import ControllerConfig
from np_control.dynamics import Dynamics
from np_control.impedance import STIFFNESS_MAX, torque
from np_control.safety import Refusal, State
from np_control.trajectory import Trajectory
from np_description.force_reflex import FORCE_REFLEX
from np_description.panda import JOINT_NAMES
from np_franka.checklist import Checklist
from np_franka.limits import CYCLE_NS, FR3_LIMITS
from np_franka.onboard import Onboard
from np_franka.robots import ROBOTS


@pytest.fixture
def start(start_robot):
    """A function that starts a driver, with or without a controller on board."""
    from np_franka.arm import FrankaArm
    from np_franka.driver import Driver

    reflex = FORCE_REFLEX

    drivers = []

    def started(onboard=None, **changes):
        _, parameters = start_robot()
        arm = FrankaArm(
            partial(ROBOTS["fr3"].open, parameters["hostname"], enforce_realtime=False),
            reflex.torques(FR3_LIMITS.torque),
            reflex.wrench(),
        )
        usual = Checklist("none", timedelta(days=1), STIFFNESS_MAX, np.ones(7), FR3_LIMITS)
        checklist = replace(usual, **changes)
        drivers.append(Driver(arm, FR3_LIMITS, checklist, onboard))
        drivers[-1].start()
        return drivers[-1]

    yield started
    for driver in drivers:
        driver.close()


@pytest.fixture
def driver(start):
    """A started driver that is commanded from outside."""
    return start()


def offer(driver, cycle, effort):
    """Ask for the measured posture and a torque."""
    driver.offer(cycle.stamp, JOINT_NAMES, cycle.reading.q, np.zeros(7), effort)


def test_a_jump_in_torque_is_spread_over_cycles_and_reaches_the_drives(driver):
    wanted = np.array([0, 0, 0, 0, 0, 0, 6.0])
    cycles = [driver.cycle()]
    while len(cycles) < 100 and driver.state is not State.STOPPED:
        offer(driver, cycles[-1], wanted)
        cycles.append(driver.cycle())
    torques = np.array([cycle.applied.torque for cycle in cycles])
    assert np.abs(np.diff(torques, axis=0)).max() <= FR3_LIMITS.torque_rate * CYCLE_NS * 1e-9 + 1e-9
    assert torques[:, 6].max() > 3.0
    # What the robot says that it was told is what was sent a cycle or two before.
    told = np.array([cycle.reading.commanded for cycle in cycles])
    assert min(np.abs(told[-1] - torques[-k]).max() for k in (2, 3, 4)) < 1e-5


def test_measured_torque_is_without_gravity(driver):
    readings = [driver.cycle().reading for _ in range(200)]
    mean = np.mean([reading.torque for reading in readings], axis=0)
    assert np.abs(mean).max() < 0.5  # the second joint alone carries several Nm against gravity


def test_stamps_begin_at_the_hosts_time_and_go_with_the_robots_clock(driver):
    cycles = [driver.cycle() for _ in range(50)]
    assert abs(cycles[0].stamp - time.time_ns()) < 60e9
    for before, after in zip(cycles, cycles[1:]):
        assert after.stamp - before.stamp == after.reading.time - before.reading.time > 0  # no window has passed


def test_recover_is_refused_while_nothing_is_wrong(driver):
    driver.cycle()
    with pytest.raises(Refusal, match="nothing to recover"):
        driver.recover()


def test_a_command_that_is_not_finite_leaves_the_last_one_in_force(driver):
    cycle = driver.cycle()
    offer(driver, cycle, np.full(7, 0.1))
    with pytest.raises(Refusal, match="not_finite"):
        offer(driver, cycle, np.full(7, np.nan))
    assert np.isfinite(driver.cycle().applied.torque).all()
    assert driver.state is State.MOVING


def test_on_board_every_cycle_gets_the_torque_of_the_law_for_its_own_state(start):
    driver = start(Onboard(ControllerConfig(), FR3_LIMITS, 300 * CYCLE_NS))
    ready = driver.cycle().reading.q
    assert driver.state is State.READY and driver.cycle().answer is None
    goal = ready + 0.01
    driver.onboard.trajectory(Trajectory(np.zeros(1), goal[None], np.zeros((1, 7))))
    cycles = [driver.cycle() for _ in range(200)]
    assert driver.state is State.MOVING
    free = [cycle for cycle in cycles[1:] if not (cycle.applied.limited or cycle.answer.limited)]
    assert len(free) > 100
    dynamics = Dynamics()
    for cycle in free:
        q, dq = cycle.reading.q, cycle.reading.dq
        law = torque(q, dq, goal, STIFFNESS_MAX, np.ones(7), dynamics.coriolis(q, dq))
        np.testing.assert_allclose(cycle.applied.torque, law, rtol=0, atol=1e-5)
    assert (cycles[-1].reading.q > ready + 1e-3).all()  # every joint is on its way


def test_what_is_not_in_order_is_a_fault_and_recover_says_so(start):
    driver = start(calibration="", damping_ratio=np.full(7, 0.1))
    assert driver.state is State.FAULT and not driver.arm.is_controlled
    for text in ("no calibration", "damping ratio: expected"):
        assert text in driver.filter.watchdog.cause
        with pytest.raises(OSError, match=text):
            driver.recover()
    assert driver.state is State.FAULT and not driver.arm.is_controlled
