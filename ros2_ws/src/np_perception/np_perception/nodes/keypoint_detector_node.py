"""Publishes the keypoints in each camera image, stamped with the image's time.

In real time the newest image wins: images that come while one is being processed are dropped but for the
last. In lockstep every image is processed.
"""

from __future__ import annotations

import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from np_description.camera import CAMERA
from np_description.domains import find_domain
from np_description.message_arrays import BadMessage, camera_info_arrays, image_array, stamp_nanoseconds
from np_perception.detector import IMAGE_SHAPE, KeypointDetector
from np_ros import qos
from np_ros.messages import keypoints_message
from np_ros.node import Diagnostics, create_steady_timer, declare_mode, parameter, run

_SAME = 0.01  # px, within which a camera's parameters are those of training
_COLLAPSED = 15  # images in a row without enough sure keypoints: half a second at 30 Hz


class KeypointDetectorNode(Node):
    """`camera/image_raw` to `keypoints`. Refused images are counted in diagnostics and logged, and give no
    keypoints."""

    def __init__(self):
        super().__init__("keypoint_detector")
        mode = declare_mode(self, "lockstep", "lockstep: every image is processed; realtime: the newest.")
        domain = parameter(self, "domain", "card", "Domain whose object is looked for: card, bump or wall.")
        weights = parameter(
            self,
            "weights",
            "",
            "Folder of released weights; empty: $NP_WEIGHTS, or `weights` of the source tree.",
        )
        threads = parameter(self, "threads", 1, "Threads of the network.", 1, 16)
        self._timeout = parameter(
            self,
            "image_timeout",
            1.0,
            "Seconds without an image after which it is reported; a warning in real time.",
            0.1,
            3600.0,
        )
        self._sure = parameter(self, "sure_score", 0.5, "Score from which a keypoint counts as sure.", 0.0, 1.0)
        self._least = parameter(
            self,
            "least_sure",
            4,
            "A warning follows fewer sure keypoints than this, 15 images in a row.",
            0,
            8,
        )
        self._realtime = mode == "realtime"
        self._detector = KeypointDetector(find_domain(domain), weights, threads)
        self._diagnostics = Diagnostics(self)
        self._unsure = 0
        self._images = 0
        self._last_image = time.monotonic()
        self._publisher = self.create_publisher(PointCloud2, "keypoints", qos.publisher(not self._realtime))
        self._misfit = ""  # why the images are not those of the camera that policies were trained with
        # First: of what waits, what has come here is taken before the images.
        self.create_subscription(CameraInfo, "camera/camera_info", self._on_info, qos.subscriber(not self._realtime))
        self.create_subscription(Image, "camera/image_raw", self._on_image, qos.subscriber(not self._realtime))
        create_steady_timer(self, min(self._timeout, 0.5), self._watch)

    def _on_info(self, message: CameraInfo) -> None:
        try:
            width, height, matrix = camera_info_arrays(message)
        except BadMessage as error:
            self._misfit = str(error)
            return
        fits = (width, height) == (CAMERA.width, CAMERA.height) and np.allclose(
            matrix, CAMERA.matrix, rtol=0, atol=_SAME
        )
        self._misfit = (
            ""
            if fits
            else (
                f"camera_info: expected {CAMERA.width} x {CAMERA.height} px, k {CAMERA.matrix.ravel().round(2).tolist()}, got "
                f"{width} x {height} px, k {matrix.ravel().round(2).tolist()}: rectify as realsense_camera does"
            )
        )

    def _on_image(self, message: Image) -> None:
        began = self._last_image = time.monotonic()
        try:
            stamp = stamp_nanoseconds(message.header.stamp)
            image = image_array(message)
            if image.shape != IMAGE_SHAPE:
                raise BadMessage(
                    "shape",
                    f"Image: expected {IMAGE_SHAPE[0]} x {IMAGE_SHAPE[1]} pixels, "
                    f"got {image.shape[0]} x {image.shape[1]}",
                )
            if self._misfit:
                raise BadMessage("camera", self._misfit)
        except BadMessage as error:
            self._diagnostics.count(f"refused images: {error.kind}")
            self.get_logger().error(f"camera/image_raw refused: {error}", throttle_duration_sec=5.0)
            return
        detection = self._detector.detect(image)
        self._publisher.publish(keypoints_message(stamp, message.header.frame_id, detection.keypoints))
        self._images += 1
        sure = int((detection.scores >= self._sure).sum())
        self._unsure = self._unsure + 1 if sure < self._least else 0
        self._diagnostics.values.update(
            {
                "images": self._images,
                "detection ms": f"{1e3 * (time.monotonic() - began):.1f}",
                "scores": np.array2string(detection.scores, precision=2),
                "sure keypoints": sure,
            }
        )
        if self._unsure >= _COLLAPSED:
            self._diagnostics.report(
                DiagnosticStatus.WARN,
                f"fewer than {self._least} keypoints with a score of "
                f"{self._sure:g} or more in {_COLLAPSED} images in a row",
            )
        else:
            self._diagnostics.report(DiagnosticStatus.OK, "running")

    def _watch(self) -> None:
        silent = time.monotonic() - self._last_image
        if silent < self._timeout:
            return
        # In lockstep time may rest, and the camera with it: reported, but no warning.
        level = DiagnosticStatus.WARN if self._realtime else DiagnosticStatus.OK
        self._diagnostics.report(level, f"no image on camera/image_raw for more than {self._timeout:g} s")


def main(args=None):
    """Run the node until SIGINT or SIGTERM."""
    return run(KeypointDetectorNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
