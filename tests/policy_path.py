"""Backend and perception of a policy path under test, which publish its inputs and keep its outputs."""

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Float64, Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from np_description.domains import CARD, sample_task
from np_description.message_arrays import stamp_nanoseconds
from np_description.panda import BASE_FRAME, NOMINAL, STATE_NAMES
from np_perception.pose_estimation import project_keypoints
from np_ros import qos
from np_ros.messages import joint_state_message, keypoints_message, pose_message
from np_ros.phases import phase_state

TICK = 100_000_000
START, GOAL = sample_task(CARD, np.random.default_rng(0))
HAND = (START.position[0], START.position[1], 0.05)
NODES = ("pre_contact", "approach", "post_contact", "episode")
INPUTS = {
    "goal_pose": (PoseStamped, qos.LATCHED),
    "keypoints": (PointCloud2, qos.LOCKSTEP),
    "joint_states": (JointState, qos.LOCKSTEP),
    "diagnostics": (DiagnosticArray, qos.EVENT),
}
OUTPUTS = {
    "episode/phase": (DiagnosticArray, qos.RECORDER_LATCHED),  # each of several in a row
    "episode/tick": (DiagnosticArray, qos.LOCKSTEP),
    "goal_keypoints": (PointCloud2, qos.LATCHED),
    "gripper_command": (Float64, qos.EVENT),
    "pre_contact_pose": (PoseStamped, qos.EVENT),
    "joint_trajectory": (JointTrajectory, qos.EVENT),
    "approach/refusal": (DiagnosticArray, qos.EVENT),
    "target_gains": (Float64MultiArray, qos.LOCKSTEP),
    "target_pose": (PoseStamped, qos.LOCKSTEP),
}


class Backend:
    """Publishes the inputs of the nodes under test and holds what they have published."""

    def __init__(self, probe, graph):
        self.probe, self.graph = probe, graph
        self._last = {}
        self._repeat_at = 0.0

    def tick(self, number):
        """Stamp (ns) of a policy tick, counted from 1."""
        return number * TICK

    def goal(self, stamp):
        self.probe.publish("goal_pose", pose_message(stamp, BASE_FRAME, GOAL.position, GOAL.quaternion), qos.LATCHED)
        self.wait(lambda: [m for m in self.received("goal_keypoints") if stamp_nanoseconds(m.header.stamp) == stamp])

    def see(self, stamp, pose=START, score=1.0, value=None):
        points = project_keypoints(CARD, pose)
        points[:, 2] = score
        if value is not None:
            points[0, 0] = value
        self._publish("keypoints", keypoints_message(stamp, "camera", points))

    def stand(self, stamp, joints=NOMINAL.ready):
        self._publish(
            "joint_states", joint_state_message(stamp, STATE_NAMES, [*joints, 0.01, 0.01], np.zeros(9), np.zeros(9))
        )

    def _publish(self, topic, message):
        self._last[topic] = message
        self._repeat_at = self.graph.seconds + 1.0
        self.probe.publish(topic, message)

    def restart(self):
        """Act as a new backend, which does not repeat the messages of the one before."""
        self._last.clear()

    def received(self, topic):
        return self.probe.messages[topic]

    def phases(self):
        return [phase_state(message) for message in self.received("episode/phase")]

    def phase(self):
        return str(self.phases()[-1]) if self.received("episode/phase") else ""

    def ticks(self):
        return [(stamp_nanoseconds(m.header.stamp), phase_state(m).phase) for m in self.received("episode/tick")]

    def wait(self, condition, what="the condition"):
        """Wait until the condition holds; repeat the last inputs once a second, as backends do in lockstep."""

        def repeat_until_condition():
            if self.graph.seconds > self._repeat_at:
                self._repeat_at = self.graph.seconds + 1.0
                for topic, message in self._last.items():
                    self.probe.publish(topic, message)
            return condition()

        self.probe.wait_until(repeat_until_condition, what=what)

    def start(self):
        response = self.probe.call("episode/start")
        assert response.success, response.message
