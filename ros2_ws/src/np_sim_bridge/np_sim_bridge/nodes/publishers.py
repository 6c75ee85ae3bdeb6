"""The publishers of a bridge, with the latest messages for subscribers that have missed them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState

from np_control.safety import AppliedCommand
from np_description.camera import Camera
from np_description.domains import Pose
from np_description.panda import BASE_FRAME, JOINT_NAMES, STATE_NAMES
from np_description.scene import CAMERA_NAME
from np_ros import qos
from np_ros.arrivals import Arrivals
from np_ros.messages import (
    JointStateWriter,
    WrenchWriter,
    camera_info_message,
    image_message,
    joint_state_message,
    pose_message,
    stamp_message,
)
from np_sim_bridge.schedule import SECOND
from np_sim_bridge.simulation import Measurement

ARRIVED_WITHIN = 2 * SECOND  # ns that time goes on without a moment at which all that was published had arrived


class BridgePublishers:
    """The topics that a bridge `node` publishes.

    camera: the nominal one; joined: called in lockstep for each new subscriber, which must get the present state even while
    time stands still. Stamps are in ns.
    """

    def __init__(self, node: Node, camera: Camera, *, lockstep: bool, joined: Callable[[], None]):
        self._camera = camera
        self._state: list[tuple] = []  # (publisher, message) of the present state
        self._joints, self._external, self._now = JointStateWriter(STATE_NAMES), WrenchWriter(BASE_FRAME), Clock()
        self._pictures: tuple[int, list[tuple]] = (
            -1,
            [],
        )  # stamp, the same of the latest image; set by the camera's thread
        stream = qos.publisher(lockstep)
        heard = PublisherEventCallbacks(matched=lambda _: joined()) if lockstep else None
        self._joint_states = node.create_publisher(JointState, "joint_states", stream, event_callbacks=heard)
        self._wrench = node.create_publisher(WrenchStamped, "external_wrench", stream)
        self._applied = node.create_publisher(JointState, "applied_command", stream)
        self._object_pose = node.create_publisher(PoseStamped, "object_pose", stream)
        self._clock = node.create_publisher(Clock, "clock", stream)
        self._image = node.create_publisher(Image, "camera/image_raw", stream, event_callbacks=heard)
        self._camera_info = node.create_publisher(CameraInfo, "camera/camera_info", stream)
        self._goal_pose = node.create_publisher(PoseStamped, "goal_pose", qos.LATCHED)
        streams = (
            self._joint_states,
            self._wrench,
            self._applied,
            self._object_pose,
            self._clock,
            self._image,
            self._camera_info,
        )
        self._arrivals = Arrivals(streams, ARRIVED_WITHIN)

    def has_arrived(self, stamp: int) -> bool:
        """Whether every subscriber has what was published until not long before `stamp`."""
        return self._arrivals.are_recent(stamp)

    def state(self, measured: Measurement, wrench: np.ndarray) -> None:
        """A new state of the arm, the external wrench (6,) N, Nm on it, and its time."""
        stamp = measured.stamp
        joints = self._joints.fill(stamp, measured.position, measured.velocity, measured.effort)
        self._joint_states.publish(joints)  # first, so that the controller computes while the rest is sent
        self._now.clock = stamp_message(stamp)
        self._clock.publish(self._now)
        external = self._external.fill(stamp, wrench)
        self._wrench.publish(external)
        self._state = [(self._joint_states, joints), (self._clock, self._now), (self._wrench, external)]

    def object_pose(self, stamp: int, pose: Pose) -> None:
        """Publish the true object pose in the last state."""
        truth = pose_message(stamp, BASE_FRAME, pose.position, pose.quaternion)
        self._object_pose.publish(truth)
        self._state.append((self._object_pose, truth))

    def image(self, stamp: int, pixels: np.ndarray) -> None:
        """An image (height, width, 3) uint8, and the camera that it is believed to be of; called in the camera's thread."""
        messages = [
            (self._camera_info, camera_info_message(stamp, CAMERA_NAME, self._camera)),
            (self._image, image_message(stamp, CAMERA_NAME, pixels)),
        ]
        for publisher, message in messages:
            publisher.publish(message)
        self._pictures = stamp, messages

    def repeat(self, stamp: int) -> None:
        """The present state, of `stamp`, once more."""
        of, images = self._pictures
        for publisher, message in [*self._state, *(images if of == stamp else [])]:
            publisher.publish(message)

    def applied(self, stamp: int, applied: AppliedCommand) -> None:
        """The command that acted on the state of `stamp`."""
        self._applied.publish(
            joint_state_message(stamp, JOINT_NAMES, applied.position, applied.velocity, applied.torque)
        )

    def goal(self, stamp: int, pose: Pose) -> None:
        """The goal of the episode that begins."""
        self._goal_pose.publish(pose_message(stamp, BASE_FRAME, pose.position, pose.quaternion))
