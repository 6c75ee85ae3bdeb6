"""The controller on board the driver: when it speaks, when it is silent, what it is led by. No hardware extra
needed.
"""

import numpy as np
import pytest

from np_control.controller import ControllerConfig
from np_control.impedance import STIFFNESS_MAX
from np_control.kinematics import forward_kinematics
from np_control.safety import Refusal
from np_control.trajectory import Trajectory
from np_description.panda import NOMINAL
from np_franka.limits import CYCLE_NS, FR3_LIMITS
from np_franka.onboard import Onboard

Q, STILL = NOMINAL.ready, np.zeros(7)
GAINS = np.stack([STIFFNESS_MAX, np.ones(7)])
TIMEOUT = 300 * CYCLE_NS


class Cycles:
    """Runs an Onboard, cycle by cycle, at one posture."""

    def __init__(self):
        self.onboard, self.now = Onboard(ControllerConfig(), FR3_LIMITS, TIMEOUT), 0

    def run(self, count=1):
        """The answers of so many cycles."""
        answers = []
        for _ in range(count):
            self.now += CYCLE_NS
            answers.append(self.onboard.answer(self.now, Q, STILL))
            self.onboard.think()
        return answers

    def aim(self, q=Q, stamp=None):
        """A target where T_E is at q, answering the newest state."""
        self.onboard.gains(GAINS)
        self.onboard.pose(self.now if stamp is None else stamp, forward_kinematics(q))


@pytest.fixture
def cycles():
    """One that has seen a few states."""
    made = Cycles()
    assert made.run(5) == [None] * 5  # nothing to follow: silent
    return made


def goal(offset):
    """A plan of one point, at rest."""
    return Trajectory(np.zeros(1), Q[None] + offset, np.zeros((1, 7)))


def test_the_first_command_asks_for_the_measured_posture(cycles):
    cycles.onboard.trajectory(goal(0.01))  # rad, which an arm that stands may be led by without pressing too hard
    first, second = cycles.run(2)
    np.testing.assert_array_equal(first.position, Q)
    np.testing.assert_allclose(second.position, Q + 0.01)


def test_in_phase_pre_it_stays_silent_until_the_episode_has_taken_the_plan(cycles):
    cycles.onboard.phase("pre")
    cycles.onboard.trajectory(goal(0.01))
    assert cycles.run(3) == [None] * 3
    cycles.onboard.phase("approach")
    first, second = cycles.run(2)
    np.testing.assert_array_equal(first.position, Q)
    np.testing.assert_allclose(second.position, Q + 0.01)


def test_a_target_takes_a_few_cycles_to_be_thought_of_and_then_the_first_is_where_the_arm_is(cycles):
    cycles.aim(Q + np.array([0, 0, 0, 0, 0, 0, 0.3]))
    answers = [answer for answer in cycles.run(40) if answer is not None]
    assert 30 < len(answers) < 40
    np.testing.assert_array_equal(answers[0].position, Q)
    assert answers[-1].position[6] > Q[6] + 0.2


def test_a_target_that_has_no_successor_falls_silent(cycles):
    cycles.aim()
    answers = cycles.run(400)
    spoken = [answer is not None for answer in answers]
    assert 300 <= sum(spoken) <= 301 and not any(spoken[310:])


def test_the_same_target_again_is_no_sign_of_life(cycles):
    stamp = cycles.now
    cycles.aim()
    cycles.run(200)
    cycles.aim(stamp=stamp)
    assert cycles.run(200)[-1] is None


def test_a_new_target_ends_the_silence(cycles):
    cycles.aim()
    cycles.run(400)
    cycles.aim()
    assert cycles.run(10)[-1] is not None


@pytest.mark.parametrize(
    "end",
    [
        lambda onboard: onboard.phase("succeeded"),
        lambda onboard: onboard.phase("failed"),
        lambda onboard: onboard.trajectory(goal(0.0)),
    ],
)
def test_after_an_episode_or_on_a_trajectory_no_target_is_due(cycles, end):
    cycles.aim()
    cycles.run(20)
    end(cycles.onboard)
    assert all(answer is not None for answer in cycles.run(500))


def test_released_it_is_silent_until_led_again(cycles):
    cycles.onboard.trajectory(goal(0.02))
    cycles.run(5)
    cycles.onboard.release()
    assert cycles.run(5) == [None] * 5
    cycles.onboard.trajectory(goal(0.03))
    assert cycles.run()[0] is not None


def test_a_gap_in_the_robots_time_is_a_new_beginning(cycles):
    cycles.onboard.trajectory(goal(0.02))
    cycles.run(5)
    cycles.now += 10**9
    assert cycles.run(3) == [None] * 3


def test_a_plan_is_broken_off_and_refused_once_the_owner_of_its_phase_is_no_more(cycles):
    for phase in ("pre", "approach"):
        cycles.onboard.phase(phase)
    cycles.onboard.trajectory(goal(0.0))
    for _ in range(3):
        cycles.run(100)
        cycles.onboard.heartbeat("approach")
    cycles.run(120)
    with pytest.raises(Refusal, match="heartbeat: expected episode/heartbeat in phase approach"):
        cycles.run(2)
    assert cycles.run(10)[-1] is not None  # the arm is held
    with pytest.raises(Refusal, match="heartbeat"):
        cycles.onboard.trajectory(goal(0.01))


def test_what_is_refused_changes_nothing(cycles):
    with pytest.raises(Refusal, match="unpaired"):
        cycles.onboard.pose(cycles.now, forward_kinematics(Q))
    with pytest.raises(Refusal, match="start"):
        cycles.onboard.trajectory(goal(0.5))
    cycles.onboard.gains(GAINS)
    position, rotation = forward_kinematics(Q)
    cycles.onboard.pose(cycles.now, (position + [0.4, 0.3, 0.2], rotation))
    with pytest.raises(Refusal, match="unreachable"):
        cycles.run(10)
    assert cycles.run(5) == [None] * 5
