"""Keypoints from the true object pose, in the detector's place: for evaluation with KEYPOINTS=truth only.

With a patch its keypoints are those of a camera that is moved, late or blurred, and of a detector that is noisy or wrong.

No node of the policy path may subscribe to `object_pose`; this one stands in for the camera and the
detector, to show what they cost.
"""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.patch import Patch, load_patch

from np_description.calibration import load_calibrated_camera
from np_description.camera import CAMERA
from np_description.domains import Pose
from np_description.keypoints import COUNT
from np_description.message_arrays import BadMessage, pose_arrays, stamp_nanoseconds
from np_description.panda import BASE_FRAME
from np_description.scene import CAMERA_NAME
from np_perception.occluded_keypoints import OccludedKeypointBuffer
from np_ros import qos
from np_ros.messages import keypoints_message
from np_ros.node import Diagnostics, declare_mode, parameter, run
from np_ros.task_domain import declare_domain


class KeypointOracle(Node):
    """Publishes the eight corners in the image for every `object_pose`, which comes when an image would."""

    def __init__(self):
        super().__init__("keypoint_oracle")
        domain = declare_domain(self)
        mode = declare_mode(self)
        self._noise = parameter(self, "noise", 0.0, "Standard deviation of the keypoints, px.", 0.0, 50.0)
        self._seed = parameter(self, "seed", 0, "Of the noise; with a stamp it names its draw.", 0, 2**31 - 1)
        calibration = parameter(self, "calibration", "", "File written by `calibrate`; empty: the camera as trained.")
        effects = parameter(self, "effects", "", "Patch file of effects that camera and detector have.")
        patch = load_patch(effects) if effects else Patch()
        self._view = CameraEffects(patch, load_calibrated_camera(calibration), self._seed)
        self._corners = OccludedKeypointBuffer(np.asarray(domain.half_size), self._view.oldest)
        self._diagnostics = Diagnostics(self)
        lockstep = mode == "lockstep"
        self._keypoints = self.create_publisher(PointCloud2, "keypoints", qos.publisher(lockstep))
        self.create_subscription(PoseStamped, "object_pose", self._on_pose, qos.subscriber(lockstep))

    def _on_pose(self, message: PoseStamped) -> None:
        try:
            stamp = stamp_nanoseconds(message.header.stamp)
            position, quaternion = pose_arrays(message, BASE_FRAME)
        except BadMessage as error:
            self._diagnostics.count(f"refused_{error.kind}")
            self.get_logger().error(f"object_pose refused: {error}", throttle_duration_sec=5.0)
            return
        self._corners.keep(stamp, Pose(position, quaternion))
        pixels = self._view.keypoints(self._corners.at, stamp)
        if self._noise:
            pixels = pixels + self._noise * np.random.default_rng((self._seed, stamp)).standard_normal((COUNT, 2))
        seen = ((pixels > -0.5) & (pixels < np.array([CAMERA.width, CAMERA.height]) - 0.5)).all(axis=1)
        self._keypoints.publish(keypoints_message(stamp, CAMERA_NAME, np.column_stack([pixels, seen.astype(float)])))


def main(args=None):
    """Run the node until SIGINT or SIGTERM."""
    return run(KeypointOracle, args)


if __name__ == "__main__":
    raise SystemExit(main())
