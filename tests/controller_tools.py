"""A controller alone or in closed loop with MuJoCo, and trajectories for it."""

import mujoco
import numpy as np

from np_control.impedance import STIFFNESS_MIN
from np_control.safety import LIMITS, SafetyFilter
from np_control.trajectory import make_trajectory
from np_description.domains import CARD
from np_description.panda import NOMINAL
from np_description.scene import load_model

PERIOD = LIMITS.period_ns
READY = NOMINAL.ready
ZERO = np.zeros(7)
SOFT = STIFFNESS_MIN, np.ones(7)


class SimulatedArm:
    """MuJoCo's arm at the start of its scene."""

    def __init__(self, model):
        self.data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, self.data, 0)

    @property
    def q(self):
        return self.data.qpos[:7].copy()

    @property
    def dq(self):
        return self.data.qvel[:7].copy()


class Arm(SimulatedArm):
    """The simulated arm behind a safety filter, one period at a time; q (7,) rad: its start, None for the ready posture."""

    def __init__(self, controller, contacts=False, q=None):
        self.model = load_model(CARD)
        if not contacts:
            self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        super().__init__(self.model)
        if q is not None:
            self.data.qpos[:7] = self.data.ctrl[:7] = q
        self.controller = controller
        self.safety = SafetyFilter()
        self.safety.start(self.q)
        self.stamp = 0
        self.observe()

    def observe(self):
        self.controller.observe(self.stamp, self.q, self.dq)

    def step(self):
        answer = self.controller.answer()
        self.safety.offer(answer.stamp, NOMINAL.joints, answer.position, answer.velocity, answer.torque, now=self.stamp)
        applied = self.safety.apply(self.stamp, self.q, self.dq)
        # The backend's guards agree with the controller's.
        np.testing.assert_array_equal(applied.torque, answer.torque)
        error = answer.position - self.q
        self.data.ctrl[:7] = applied.torque
        mujoco.mj_step(self.model, self.data)
        self.stamp += PERIOD
        self.observe()
        return answer, error


def quintic(goal, duration, count=21):
    """A trajectory from the ready posture to `goal` (7,) rad in `duration` s, at rest at both ends."""
    s = np.linspace(0, 1, count)[:, None]
    share, rate = s**3 * (10 - 15 * s + 6 * s * s), 30 * s**2 * (1 - s) ** 2 / duration
    return make_trajectory(s[:, 0] * duration, READY + share * (goal - READY), rate * (goal - READY), LIMITS)


def answers(controller, periods, first=0):
    """The answers of so many periods, from period `first` on, with the arm at its ready posture."""
    given = []
    for stamp in range(first * PERIOD, (first + periods) * PERIOD, PERIOD):
        controller.observe(stamp, READY, ZERO)
        given.append(controller.answer())
    return given
