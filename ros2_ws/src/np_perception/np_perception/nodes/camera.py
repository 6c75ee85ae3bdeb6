"""What camera nodes share: images of a source, rectified to the view of the policies, on camera/image_raw and
camera_info.

A thread of its own waits for images, rectifies and publishes them; the node's thread publishes `diagnostics`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

from np_description.calibration import CalibrationError, load
from np_description.message_arrays import TURNED_CAMERA
from np_description.scene import CAMERA_NAME
from np_perception.camera.rectify import VIEWS, Rectifier, view_camera
from np_perception.camera.source import CameraError, CameraSource, EndOfImages
from np_ros import qos
from np_ros.messages import camera_info_message, image_message
from np_ros.node import Diagnostics, create_steady_timer, declare_mode, parameter

_RETRY = 1.0  # s between attempts to find a camera that has gone
_READ = 0.1  # s


class CameraNode(Node):
    """Publishes what a Source gives. A subclass declares its parameters and calls `begin` with what opens the
    source."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        mode = declare_mode(self, "realtime", "realtime: the newest image counts; lockstep: every one.")
        view = parameter(
            self,
            "view",
            "policy",
            "policy: the images that policies see; calibration: the same field of "
            "view in more pixels, for the command `calibrate`.",
            choices=VIEWS,
        )
        file = parameter(self, "calibration", "", "File written by `calibrate`; empty: images are not turned.")
        self._timeout = parameter(
            self,
            "image_timeout",
            0.5,
            "Seconds without an image after which the camera is reported as silent, and opened anew.",
            0.1,
            60.0,
        )
        self._calibration = load(file) if file else None
        self._camera = view_camera(view, self._calibration)
        self.diagnostics = Diagnostics(self)
        self.diagnostics.values.update(mode=mode, view=view, calibration=file or "none")
        if self._calibration is not None:
            distance, angle = self._calibration.displacement
            self.diagnostics.values.update(
                {
                    "calibration age days": f"{self._calibration.age().total_seconds() / 86400:.1f}",
                    "camera displaced": (
                        f"{1e3 * distance:.1f} mm, {np.degrees(angle):.2f} degrees from where the policies learned"
                    ),
                }
            )
        stream = qos.publisher(mode == "lockstep")
        self._info = self.create_publisher(CameraInfo, "camera/camera_info", stream)
        self._image = self.create_publisher(Image, "camera/image_raw", stream)
        self._status = (DiagnosticStatus.OK, "starting")
        self._images = self._losses = 0
        self._source: CameraSource | None = None
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def begin(self, open_source: Callable[[], CameraSource], subscribers: int = 0, retry: bool = True) -> None:
        """Open the source and start to publish, as soon as there are that many subscribers to the images.

        Raises CameraError or CalibrationError if it cannot be opened now; with `retry` one that goes later is
        opened anew.
        """
        self._open_source, self._subscribers, self._retry = open_source, subscribers, retry
        self._open()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()
        create_steady_timer(self, 0.1, self._report)

    def _open(self) -> None:
        source = self._open_source()
        try:
            self._rectify = Rectifier(source.lens, self._camera, self._turn(source.turn))
        except CalibrationError:
            source.close()
            raise
        self._source = source
        # From the camera's own frame to that of what we publish
        self._turned = self._rectify.turn @ source.turn
        self._frame = CAMERA_NAME if (self._turned == np.eye(3)).all() else TURNED_CAMERA

    def _turn(self, upstream: np.ndarray) -> np.ndarray | None:
        """From the source's images to ours: the calibration's rotation of the camera, less what was turned
        upstream."""
        return None if self._calibration is None else self._calibration.turn @ np.asarray(upstream).T

    # In the camera's thread

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                self._stream()
            except EndOfImages as end:
                self._status = DiagnosticStatus.OK, str(end)
                return
            except (CameraError, CalibrationError, ValueError) as error:
                self._losses += self._source is not None
                self._status = DiagnosticStatus.ERROR, str(error)
                self._release()
                if not self._retry:
                    return
                self._closing.wait(_RETRY)

    def _stream(self) -> None:
        if self._source is None:
            self._open()
        while self._image.get_subscription_count() < self._subscribers and not self._closing.wait(0.02):
            self._status = DiagnosticStatus.OK, f"waiting for {self._subscribers} subscribers"
        self._subscribers = 0  # only before the first image
        heard, patience = time.monotonic(), max(self._timeout, 2 * self._source.period)
        while not self._closing.is_set():
            frame = self._source.read(_READ)
            if frame is not None:
                heard = time.monotonic()
                self._publish(frame.stamp, frame.pixels)
                self._status = DiagnosticStatus.OK, "running"
            elif time.monotonic() - heard > patience:
                raise CameraError(f"no image for more than {patience:g} s: is the camera plugged in?")

    def _publish(self, stamp: int, pixels: np.ndarray) -> None:
        view = self._rectify(pixels)
        self._info.publish(camera_info_message(stamp, self._frame, self._camera, self._turned))
        self._image.publish(image_message(stamp, self._frame, view))
        self._images += 1

    def _release(self) -> None:
        source, self._source = self._source, None
        if source is not None:
            source.close()

    # In the node's thread

    def _report(self) -> None:
        source = self._source
        if source is not None:
            self.diagnostics.values.update(source.values)
        self.diagnostics.values.update({"images": self._images, "camera lost": self._losses})
        self.diagnostics.report(*self._status)

    def destroy_node(self) -> None:
        """Let go of the camera."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join()
        self._release()
        super().destroy_node()
