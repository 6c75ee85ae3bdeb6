"""Faults of a topic over DDS: its publisher has another name for it, and a relay sends on what it says under the usual one."""

from __future__ import annotations

from rclpy.node import Node

from np_evaluation.simtest.endpoints import Weather
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
"""Who publishes a topic that a fault can change."""


class Relay:
    """Sends on what comes on a topic with BEFORE behind its name, as the weather of `network` has it."""

    def __init__(self, node: Node, topic: str, network: Network, *, is_lockstep: bool):
        kind = find_message_class(BY_NAME[topic].type)
        incoming = outgoing = qos.LATCHED if BY_NAME[topic].latched else qos.EVENT
        if topic in STREAMS:  # here none is to be lost by the relay itself
            incoming, outgoing = qos.RECORDER, qos.publisher(is_lockstep)
        self._topic, self._network, self._is_lossy, self._last = f"/{topic}", network, not is_lockstep, 0
        self._publisher = node.create_publisher(kind, topic, outgoing)
        node.create_subscription(kind, topic + BEFORE, self._send_on, incoming, raw=True)

    def _send_on(self, data: bytes) -> None:
        now, scheduler = self._network.weather.get(self._topic, Weather()), self._network.scheduler
        is_lost = self._is_lossy and scheduler.rng.random() < now.loss  # who reads reliably loses nothing
        if now.is_silent or is_lost:
            return
        data = now.change(data) if now.change else data
        when = max(self._last, scheduler.now + now.delay)
        for _ in range(1 + (scheduler.rng.random() < now.duplicates)):
            if when > scheduler.now:
                scheduler.at(when, lambda: self._publisher.publish(data))
            else:  # at once: the relay may be in the loop of control
                self._publisher.publish(data)
        self._last = when
