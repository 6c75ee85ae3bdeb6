"""The robot: observation of joints, keypoints and image; action as hand pose and gains."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from geometry_msgs.msg import PoseStamped
from lerobot.robots import Robot
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from sensor_msgs.msg import Image, JointState, PointCloud2
from std_msgs.msg import Float64MultiArray

from np_control.impedance import DAMPING_RATIO_MAX, DAMPING_RATIO_MIN, STIFFNESS_MAX, STIFFNESS_MIN
from np_description.camera import CAMERA
from np_description.keypoints import COUNT
from np_description.message_arrays import image_array, joint_state_arrays, keypoints_array, stamp_nanoseconds
from np_description.panda import BASE_FRAME, JOINT_NAMES, STATE_NAMES
from np_ros import qos
from np_ros.messages import gains_message, pose_message

from .config_np_franka import POSE, NpFrankaConfig
from .listener import Listener

POSE_ACTION = (
    *(f"hand.{axis}" for axis in ("x", "y", "z", "qw", "qx", "qy", "qz")),
    *(f"{joint}.stiffness" for joint in JOINT_NAMES),
    *(f"{joint}.damping_ratio" for joint in JOINT_NAMES),
)
"""T_E in panda_link0, m and a unit quaternion; Nm/rad; rho. The order is that of `policy.target` of export_lerobot."""
JOINT_ACTION = tuple(f"{joint}.pos" for joint in JOINT_NAMES)
"""Joint targets, rad."""


class NpFranka(Robot):
    """Needs a backend, the controller and, for keypoints, the detector of this project in real time."""

    config_class = NpFrankaConfig
    name = "np_franka"

    def __init__(self, config: NpFrankaConfig):
        super().__init__(config)
        self.config = config
        self.cameras = {"camera": None} if config.image else {}  # LeRobot counts them
        self._listener: Listener | None = None

    @cached_property
    def observation_features(self) -> dict:
        """Position rad or m, velocity rad/s or m/s, torque Nm or N without gravity; pixels and scores; the image."""
        names = [f"{joint}.{part}" for part in ("pos", "vel", "effort") for joint in STATE_NAMES]
        if self.config.keypoints:
            names += [f"keypoint_{i}.{part}" for i in range(COUNT) for part in ("u", "v", "score")]
        if self.config.goal:
            names += [f"goal_{i}.{part}" for i in range(COUNT) for part in ("u", "v")]
        images = {"camera": (CAMERA.height, CAMERA.width, 3)} if self.config.image else {}
        return {**dict.fromkeys(names, float), **images}

    @cached_property
    def action_features(self) -> dict:
        """Pose and gains; joint targets where somebody else commands."""
        return dict.fromkeys(POSE_ACTION if self.config.command == POSE else JOINT_ACTION, float)

    @property
    def is_connected(self) -> bool:
        """Whether a message has arrived on every topic."""
        return self._listener is not None

    @property
    def is_calibrated(self) -> bool:
        """The arm's joints need none; the camera has `calibrate` of np_perception."""
        return True

    def calibrate(self) -> None:
        """Nothing to do."""

    def configure(self) -> None:
        """Nothing to do."""

    def connect(self, calibrate: bool = True) -> None:
        """Join the graph. Raises TimeoutError that names the topics without a publisher."""
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self.name} is connected")
        topics = {"joint_states": JointState}
        if self.config.keypoints:
            topics["keypoints"] = PointCloud2
        if self.config.goal:
            topics["goal_keypoints"] = PointCloud2
        if self.config.image:
            topics["camera/image_raw"] = Image
        listener = Listener("lerobot_robot", topics, self.config.timeout)
        try:
            if self.config.command == POSE:
                for topic, message_type in (("target_gains", Float64MultiArray), ("target_pose", PoseStamped)):
                    listener.client.advertise(topic, message_type, qos.REALTIME_PUBLISHER)
                both = ("target_gains", "target_pose")
                listener.client.wait_until(lambda: all(map(listener.client.matched, both)), what="a controller")
            listener.start()
        except BaseException:
            listener.close()
            raise
        self._listener = listener

    def get_observation(self) -> dict:
        """The newest of each topic. Raises BadMessage for one that breaks the graph's contract."""
        listener = self._connected()
        values = np.concatenate(joint_state_arrays(listener.newest("joint_states"), STATE_NAMES))
        if self.config.keypoints:
            values = np.concatenate([values, keypoints_array(listener.newest("keypoints")).ravel()])
        if self.config.goal:
            values = np.concatenate([values, keypoints_array(listener.newest("goal_keypoints"))[:, :2].ravel()])
        found = {name: float(value) for name, value in zip(self.observation_features, values)}
        if self.config.image:
            found["camera"] = image_array(listener.newest("camera/image_raw"))
        return found

    def send_action(self, action: dict) -> dict:
        """Publish gains, cut to their ranges, and the pose; what was sent. Raises ValueError for a pose without rotation."""
        listener = self._connected()
        if self.config.command != POSE:
            return action
        values = np.array([float(action[name]) for name in POSE_ACTION])
        norm = np.linalg.norm(values[3:7])
        if not np.isfinite(values).all() or norm < 1e-6:
            raise ValueError(f"action: expected finite numbers and a quaternion, got {values.tolist()}")
        values[3:7] /= norm
        values[7:14] = np.clip(values[7:14], STIFFNESS_MIN, STIFFNESS_MAX)
        values[14:] = np.clip(values[14:], DAMPING_RATIO_MIN, DAMPING_RATIO_MAX)
        stamp = stamp_nanoseconds(listener.newest("joint_states").header.stamp)
        listener.client.publish("target_gains", gains_message(values[7:].reshape(2, 7)))
        listener.client.publish("target_pose", pose_message(stamp, BASE_FRAME, values[:3], values[3:7]))
        return dict(zip(POSE_ACTION, values.tolist()))

    def disconnect(self) -> None:
        """Leave the graph; the controller holds the last target."""
        self._connected().close()
        self._listener = None

    def _connected(self) -> Listener:
        if self._listener is None:
            raise DeviceNotConnectedError(f"{self.name} is not connected: call connect() first")
        return self._listener
