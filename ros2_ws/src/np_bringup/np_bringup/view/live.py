"""The present moment of a graph that is running."""

from __future__ import annotations

import threading
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import Image, JointState

from np_bringup.view.recorded import encode_image, error
from np_bringup.view.shown_joints import ShownJoints
from np_bringup.view.window import Moment
from np_description.domains import Pose, Task
from np_description.drawing.scene_data import SceneData
from np_description.message_arrays import BadMessage, image_array, pose_arrays
from np_description.panda import BASE_FRAME
from np_ros import qos
from np_ros.client.graph_client import GraphClient
from np_ros.goals import episode_goal
from np_ros.low_latency.raw import decode_raw
from np_ros.phases import phase_state

_SILENT = "no joint_states in this ROS_DOMAIN_ID"


class LiveGraph:
    """Subscribes with a peer, whose thread calls `spin_once`; the page's threads read. Nothing is published.

    meshes: as in `drawn_model`.
    """

    def __init__(self, peer: GraphClient, domain: Task, *, meshes: bool | None = None):
        self._scene, self._lock = SceneData(domain, meshes=meshes), threading.Lock()
        self._joints = ShownJoints(partial(decode_raw, kind=JointState))
        self._pose: Pose | None = None
        self._goal: Pose | None = None
        self._episode_goal: Pose | None = None
        self._phase, self._image, self._image_fault = "", None, ""
        node = peer.node
        stream = qos.REALTIME_SUBSCRIBER
        node.create_subscription(JointState, "joint_states", self._joints.add, qos.VIEWER, raw=True)
        node.create_subscription(PoseStamped, "object_pose", self._on_pose, stream)
        node.create_subscription(PoseStamped, "goal_pose", self._on_goal, qos.LATCHED)
        node.create_subscription(DiagnosticArray, "diagnostics", self._on_diagnostics, qos.EVENT)
        node.create_subscription(DiagnosticArray, "episode/phase", self._on_phase, qos.LATCHED)
        node.create_subscription(Image, "camera/image_raw", self._on_image, stream)

    def scene(self) -> dict:
        """The shapes to draw, and the kind of source."""
        return {**self._scene.scene(), "live": True, "has_images": True}

    def state(self) -> dict:
        """Time s, poses, phase and error now; `poses` null, and why, before the first joint state."""
        pose, goal = self._pose, self._episode_goal or self._goal
        try:
            stamp, joints = self._joints.read()
        except BadMessage as bad:
            words = self._words(f"joint_states: {bad}" if self._joints else _SILENT)
            return {"time": 0.0, "poses": None, "phase": words, **error(None, None)}
        with self._lock:  # the scene's kinematics have one place for what they compute
            poses = self._scene.poses(joints, pose, goal)
        return {"time": stamp / 1e9, "poses": poses, "phase": self._words(self._phase), **error(pose, goal)}

    def moment(self) -> Moment | None:
        """Joints, object and goal now; None before the first joint state that can be read."""
        try:
            joints = self._joints.read()[1]
        except BadMessage:
            return None
        return Moment(joints, self._pose, self._episode_goal or self._goal)

    def image(self, time: float) -> bytes | None:
        """The JPEG of the newest image, None where there is none, or none that can be read: then `state` has the reason."""
        message = self._image
        try:
            picture = None if message is None else encode_image(image_array(message))
        except BadMessage as bad:
            picture, self._image_fault = None, f"camera/image_raw: {bad}"
        else:
            self._image_fault = ""
        return picture

    def _words(self, first: str) -> str:
        return "; ".join(filter(None, (first, self._image_fault)))

    def _on_pose(self, message: PoseStamped) -> None:
        self._pose = _read(message, self._pose)

    def _on_goal(self, message: PoseStamped) -> None:
        self._goal = _read(message, self._goal)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self._episode_goal = episode_goal(message) or self._episode_goal

    def _on_phase(self, message: DiagnosticArray) -> None:
        try:
            self._phase = str(phase_state(message))
        except BadMessage:
            pass  # who acts on it counts it

    def _on_image(self, message: Image) -> None:
        self._image = message


def _read(message: PoseStamped, before: Pose | None) -> Pose | None:
    """The pose of a message; of one that cannot be read, which others count, the one before."""
    try:
        return Pose(*pose_arrays(message, BASE_FRAME))
    except BadMessage:
        return before
