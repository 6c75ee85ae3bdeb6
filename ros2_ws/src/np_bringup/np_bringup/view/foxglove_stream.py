"""The graph's topics, live or of a bag, for the Foxglove app: over its WebSocket, or into an MCAP file.

Messages go on as they are, CDR with their ROS 2 definitions. Added are `scene_markers`, the arm, object and goal, and
`corners`, the keypoints and their goals in the image. Needs foxglove-sdk (`make foxglove`).
"""

from __future__ import annotations

import time
from functools import partial

import foxglove
from foxglove.messages import Color, ImageAnnotations, Point2, PointsAnnotation, PointsAnnotationType, Timestamp

from np_bringup.nodes.robot_state_node import markers
from np_bringup.view.shown_joints import ShownJoints
from np_description.control_rate import SECOND
from np_description.domains import Pose, Task
from np_description.drawing.scene_data import SceneData
from np_description.message_arrays import BadMessage, keypoints_array, pose_arrays
from np_description.panda import BASE_FRAME
from np_record.bag import Message, Recording
from np_record.cdr import TYPESTORE
from np_record.nodes.recorder_node import find_message_class
from np_record.topics import TIMELINE, TOPICS, Topic
from np_ros import qos
from np_ros.client.graph_client import GraphClient
from np_ros.messages import serialize

SCENE, CORNERS = "/scene_markers", "/corners"
_PERIOD = 50_000_000  # ns between scenes
_COLOURS = {"keypoints": Color(r=1.0, g=0.8, b=0.0, a=1.0), "goal_keypoints": Color(r=0.2, g=0.8, b=0.3, a=1.0)}


class FoxgloveStream:
    """Channels of a context, whose server or file the caller opens."""

    def __init__(self, domain: Task, context: foxglove.Context) -> None:
        self._context, self._channels = context, {}
        self._corners = foxglove.channels.ImageAnnotationsChannel(CORNERS, context=context)
        self._data = SceneData(domain, meshes=False)
        self._scene = self._data.scene()
        self._seen: dict[str, object] = {}
        self._joints = ShownJoints(Message.decode)
        self._due = 0

    def send(self, topic: Topic, data: bytes, stamp: int) -> None:
        """A message, serialized, of `stamp` ns; what cannot be read goes on, and is not drawn."""
        self._channel(f"/{topic.name}", topic.type).log(data, log_time=stamp)
        try:
            self._draw(Message(stamp, topic, data))
        except BadMessage:
            pass

    def _draw(self, message: Message) -> None:
        name = message.topic.name
        if name in ("object_pose", "goal_pose"):
            self._seen[name] = Pose(*pose_arrays(message.decode(), BASE_FRAME))
        elif name in _COLOURS:
            self._seen[name] = keypoints_array(message.decode())[:, :2]
            self._corners.log(self._annotations(message.stamp), log_time=message.stamp)
        elif name == "joint_states":
            self._joints.add(message)
            if message.stamp < self._due:
                return
            poses = self._data.poses(self._joints.read()[1], self._seen.get("object_pose"), self._seen.get("goal_pose"))
            content = serialize(markers(self._scene, poses, message.stamp))
            self._channel(SCENE, "visualization_msgs/msg/MarkerArray").log(content, log_time=message.stamp)
            self._due = message.stamp + _PERIOD

    def _annotations(self, stamp: int) -> ImageAnnotations:
        """Foxglove's pixels begin at the corner of the first one, ours at its centre."""
        when = Timestamp(sec=stamp // SECOND, nsec=stamp % SECOND)
        return ImageAnnotations(
            points=[
                PointsAnnotation(
                    timestamp=when,
                    type=PointsAnnotationType.Points,
                    points=[Point2(x=u + 0.5, y=v + 0.5) for u, v in self._seen[name].tolist()],
                    outline_color=colour,
                    thickness=3.0,
                )
                for name, colour in _COLOURS.items()
                if name in self._seen
            ]
        )

    def _channel(self, name: str, message_type: str) -> foxglove.Channel:
        if name not in self._channels:
            definition, _ = TYPESTORE.generate_msgdef(message_type, ros_version=2)
            schema = foxglove.Schema(name=message_type, encoding="ros2msg", data=definition.encode())
            self._channels[name] = foxglove.Channel(name, schema=schema, message_encoding="cdr", context=self._context)
        return self._channels[name]


def play(recording: Recording, stream: FoxgloveStream, *, paced: bool = True) -> None:
    """Send a bag's messages as fast as they came, or at once."""
    began = time.monotonic()
    for message in recording.messages():
        if paced and (early := (message.stamp - recording.start) / SECOND - (time.monotonic() - began)) > 0:
            time.sleep(early)
        stream.send(message.topic, message.data, message.stamp)


def listen(peer: GraphClient, stream: FoxgloveStream) -> None:
    """Send what comes in the graph of `peer`, whose caller spins, at the time of the wall."""
    for topic in TOPICS:
        volatile = qos.VIEWER if topic is TIMELINE else qos.REALTIME_SUBSCRIBER
        profile = qos.LATCHED if topic.latched else volatile
        forward = partial(_forward, stream, topic)
        peer.node.create_subscription(find_message_class(topic.type), topic.name, forward, profile, raw=True)


def _forward(stream: FoxgloveStream, topic: Topic, data: bytes) -> None:
    stream.send(topic, bytes(data), time.time_ns())
