"""The controller's node through the phases of an episode, with an arm that follows its targets."""

import numpy as np
import pytest
from impedance_tools import GAINS, PERIOD, POSITION, QUATERNION, answered, counted, is_counted, plan, publish_phase
from std_msgs.msg import String

from np_description.panda import BASE_FRAME, JOINT_NAMES, NOMINAL
from np_ros import qos
from np_ros.messages import gains_message, pose_message, trajectory_message


class FollowingArm:
    """Goes where the controller wants it, a period at a time. Nobody waits for ticks, as in real time. heartbeat: sent with each state."""

    def __init__(self, start_controller, send_state, probe, **parameters):
        start_controller(tick_barrier=False, **parameters)
        self._send_state, self._probe, self.stamp, self.joints = send_state, probe, 0, NOMINAL.ready
        self.heartbeat = ""
        self.step()  # the first state is a beginning, which an episode has to come after

    def step(self, periods=1):
        """The joint target after so many periods."""
        for _ in range(periods):
            self.stamp += PERIOD
            self._probe.messages["effort_command"].clear()
            if self.heartbeat:
                self._probe.publish("episode/heartbeat", String(data=self.heartbeat))
            self._send_state(self.stamp, self.joints)
            self.joints = answered(self._probe, self.stamp)[0]
        return self.joints

    def until(self, condition, what):
        """Go on until the condition holds, asked every tenth period."""
        self._probe.wait_until(lambda: condition(self.step(10)), what=what)


@pytest.fixture
def arm(start_controller, send_state, probe):
    return FollowingArm(start_controller, send_state, probe)


def test_the_end_of_an_episode_stops_an_arm_on_its_way_and_late_plans_are_refused(arm, probe):
    goal = NOMINAL.ready + 0.4
    for phase in ("pre", "approach"):
        publish_phase(probe, phase)
        arm.step(2)
    probe.publish("joint_trajectory", plan(0, [0.0, 2.0], goal), qos.EVENT)
    arm.until(lambda joints: (joints > NOMINAL.ready + 0.1).all(), "the way")
    publish_phase(probe, "failed", "approach: stopped on request")
    rest = comes_to_rest(arm)
    assert (rest < NOMINAL.ready + 0.3).all()
    probe.publish(
        "joint_trajectory", trajectory_message(0, JOINT_NAMES, [0.0, 1.0], [rest, goal], np.zeros((2, 7))), qos.EVENT
    )
    counted(probe, "refused_state")
    np.testing.assert_array_equal(arm.step(50), rest)


def comes_to_rest(arm):
    """Its joints then."""
    before = None

    def rests(joints):
        nonlocal before
        is_still, before = before is not None and (joints == before).all(), joints
        return is_still

    arm.until(rests, "rest")
    return arm.joints


def test_without_heartbeats_an_arm_on_its_way_comes_to_rest(start_controller, send_state, probe):
    probe.advertise("episode/heartbeat", String)
    arm = FollowingArm(start_controller, send_state, probe, mode="realtime")
    for arm.heartbeat in ("pre", "approach"):
        publish_phase(probe, arm.heartbeat)
        arm.step(2)
    probe.publish("joint_trajectory", plan(0, [0.0, 2.0], NOMINAL.ready + 0.4), qos.EVENT)
    arm.until(lambda joints: (joints > NOMINAL.ready + 0.1).all(), "the way")
    arm.heartbeat = ""
    assert (comes_to_rest(arm) < NOMINAL.ready + 0.3).all()
    counted(probe, "refused_heartbeat")


def test_after_a_fault_the_arm_is_held_again(arm, send_state, probe):
    arm.step()
    publish_phase(probe, "fault", "test")
    pushed = NOMINAL.ready + 0.003

    def goes_along(_):
        arm.joints = pushed
        return (arm.step() == pushed).all()

    arm.until(goes_along, "the target to go along")
    publish_phase(probe, "idle")

    def holds(_):
        before = arm.step()
        arm.joints = before + 0.002  # somebody pushes
        return (arm.step() == before).all()

    arm.until(holds, "the arm to be held")
    send_state(arm.stamp + PERIOD, arm.joints + 0.002)
    assert (answered(probe, arm.stamp + PERIOD)[2] < 0).all()


def test_an_arm_that_comes_back_in_the_middle_of_an_episode_is_not_moved(arm, probe):
    """Its driver was restarted: the policy went on for the one before."""
    for phase in ("pre", "post"):
        publish_phase(probe, phase)
        arm.step(10)
    arm.stamp += 10**9
    arm.step()
    is_left_alone(arm, probe)


def test_a_controller_that_comes_in_the_middle_of_an_episode_moves_nothing(arm, probe):
    """It was restarted, or was on board of a driver that was; the phase, latched, it hears after its first state."""
    publish_phase(probe, "post")
    arm.step(10)
    is_left_alone(arm, probe)


def is_left_alone(arm, probe):
    """Whatever the policy asks for."""

    def refused(_):
        probe.publish("target_gains", gains_message(GAINS))
        probe.publish("target_pose", pose_message(arm.stamp, BASE_FRAME, POSITION + [0.02, 0, 0], QUATERNION))
        return is_counted(probe, "refused_state")

    arm.until(refused, "the target to be refused")
    np.testing.assert_array_equal(arm.step(30), NOMINAL.ready)
