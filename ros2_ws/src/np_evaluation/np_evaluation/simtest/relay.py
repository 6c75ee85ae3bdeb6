"""Faults of a topic over DDS: the publisher uses another topic name, and a relay republishes under the usual one."""

from __future__ import annotations

from rclpy.node import Node

from np_evaluation.simtest.endpoints import TopicFault
from np_evaluation.simtest.faults import STREAMS
from np_evaluation.simtest.network import Network
from np_record.nodes.recorder_node import find_message_class
from np_record.topics import BY_NAME
from np_ros import qos

BEFORE = "_before_faults"
PUBLISHER = {
    "joint_states": "sim_bridge",
    "object_pose": "sim_bridge",
    "goal_pose": "sim_bridge",
    "effort_command": "joint_impedance",
    "keypoints": "keypoint_oracle",
    "target_pose": "post_contact",
    "target_gains": "post_contact",
    "joint_trajectory": "approach",
    "gripper_command": "pre_contact",
    "pre_contact_pose": "pre_contact",
    "goal_keypoints": "episode",
    "episode/phase": "episode",
    "episode/tick": "episode",
}
"""Publishing node of each topic that a fault can change."""


class Relay:
    """Republishes the topic with suffix BEFORE, changed by the fault of `network` for this topic."""

    def __init__(self, node: Node, topic: str, network: Network, *, is_lockstep: bool):
        kind = find_message_class(BY_NAME[topic].type)
        incoming = outgoing = qos.LATCHED if BY_NAME[topic].latched else qos.EVENT
        if topic in STREAMS:  # the relay itself must lose none
            incoming, outgoing = qos.RECORDER, qos.publisher(is_lockstep)
        self._topic, self._network, self._is_lossy, self._last = f"/{topic}", network, not is_lockstep, 0
        self._publisher = node.create_publisher(kind, topic, outgoing)
        node.create_subscription(kind, topic + BEFORE, self._relay, incoming, raw=True)

    def _relay(self, data: bytes) -> None:
        fault, scheduler = self._network.topic_faults.get(self._topic, TopicFault()), self._network.scheduler
        is_lost = self._is_lossy and scheduler.rng.random() < fault.loss  # reliable readers lose nothing
        if fault.is_silent or is_lost:
            return
        data = fault.change(data) if fault.change else data
        when = max(self._last, scheduler.now + fault.delay)
        for _ in range(1 + (scheduler.rng.random() < fault.duplicates)):
            if when > scheduler.now:
                scheduler.call_at(when, lambda: self._publisher.publish(data))
            else:  # at once: the relay may be in the control loop
                self._publisher.publish(data)
        self._last = when
