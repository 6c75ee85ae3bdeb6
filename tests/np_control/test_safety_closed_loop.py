"""The safety filter around the simulated arm: walls, speed, stop, under commands that mean harm."""

import mujoco
import numpy as np
import pytest
from controller_tools import SimulatedArm

from np_control.impedance import STIFFNESS_MAX
from np_control.impedance import torque as impedance_torque
from np_control.safety import LIMITS, SafetyFilter, State, clamp_torque
from np_description.domains import CARD
from np_description.panda import NOMINAL
from np_description.scene import load_model

PERIOD = LIMITS.period_ns
READY = NOMINAL.ready
MODEL = load_model(CARD)
MODEL.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT


class Arm(SimulatedArm):
    """The arm without contacts, every torque through the filter; keeps the extremes it saw."""

    def __init__(self):
        super().__init__(MODEL)
        self.safety = SafetyFilter()
        self.safety.start(self.q)
        self.periods = 0
        self.fastest, self.least_room = np.zeros(7), np.full(7, np.inf)

    def step(self, torque=None):
        """One period, with a command or in silence."""
        now = self.periods * PERIOD
        if torque is not None:
            # The first joint target must be the measured position; the others do not matter here.
            target = np.clip(self.q, LIMITS.position_lower, LIMITS.position_upper)
            self.safety.offer(now, NOMINAL.joints, target, np.zeros(7), torque, now)
        applied = self.safety.apply(now, self.q, self.dq)
        self.data.ctrl[:7] = applied.torque
        mujoco.mj_step(MODEL, self.data)
        self.periods += 1
        self.fastest = np.maximum(self.fastest, np.abs(self.dq))
        room = np.minimum(self.q - LIMITS.position_lower, LIMITS.position_upper - self.q)
        self.least_room = np.minimum(self.least_room, room)
        return applied

    def torque_of(self, joint, sign):
        """Full torque on one joint, the others held."""
        torque = impedance_torque(self.q, self.dq, READY, STIFFNESS_MAX, np.ones(7), np.zeros(7))
        torque[joint] = sign * LIMITS.torque[joint]
        return clamp_torque(LIMITS, torque)


@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("sign", [-1, 1])
def test_full_torque_towards_a_joint_limit_ends_at_the_wall(joint, sign):
    arm = Arm()
    for _ in range(1500):
        arm.step(arm.torque_of(joint, sign))
    assert arm.safety.state is State.MOVING  # no limit was exceeded, nothing faulted
    assert (arm.fastest < LIMITS.velocity).all()
    assert (arm.least_room > 0).all()
    wall = (LIMITS.wall_upper if sign > 0 else LIMITS.wall_lower)[joint]
    assert arm.q[joint] == pytest.approx(wall, abs=0.03)  # it got there: a wall, not a fence far off


def test_the_wall_stands_before_the_joint_limit():
    """Half of its 0.05 rad is left when full torque has driven the slowest joint against it."""
    arm = Arm()
    for _ in range(1500):
        arm.step(arm.torque_of(6, 1))
    assert arm.least_room[6] > 0.025


def test_a_held_arm_hardly_swings_past_its_target():
    """The shoulder, the heaviest joint, pushed off at 0.5 rad/s: what it swings back beyond its target is a fifth of its way out."""
    arm = Arm()
    arm.data.qvel[1] = 0.5
    way = []
    for _ in range(500):
        assert arm.step().state is State.READY
        way.append(arm.q[1] - READY[1])
    assert max(way) > 0.01 and -min(way) < 0.2 * max(way)


@pytest.mark.parametrize("joint", [0, 3, 5])
@pytest.mark.parametrize("ending", ["stop", "silence"])
def test_from_speed_the_arm_comes_to_rest_and_stays(joint, ending):
    arm = Arm()
    while arm.fastest[joint] < 0.6 * LIMITS.velocity[joint]:
        arm.step(arm.torque_of(joint, 1))
    if ending == "stop":
        arm.safety.stop("test")
    for _ in range(500):
        applied = arm.step()
    assert applied.state is State.STOPPED
    assert np.abs(arm.dq).max() < LIMITS.rest_speed and arm.safety.at_rest
    assert (arm.fastest < LIMITS.velocity).all()
    arm.safety.recover(arm.q)
    applied = arm.step()
    assert applied.state is State.READY
    np.testing.assert_allclose(applied.position, arm.q, atol=1e-3)


def test_harmful_torques_on_all_joints_never_reach_a_joint_limit():
    """Speed can exceed its limit, as joints throw each other about; that is a fault, and ends at rest."""
    rng = np.random.default_rng(0)
    for _ in range(6):
        arm = Arm()
        torque = rng.choice([-1, 1], 7) * LIMITS.torque
        while arm.safety.watchdog.may_move and arm.periods < 1500:
            if rng.random() < 0.02:
                torque = rng.choice([-1, 0, 1], 7) * LIMITS.torque
            arm.step(torque)
        arm.safety.stop("enough")
        for _ in range(750):
            arm.step()
        assert arm.safety.at_rest
        assert (arm.least_room > 0).all()
        assert (arm.fastest < 2 * LIMITS.velocity).all()
