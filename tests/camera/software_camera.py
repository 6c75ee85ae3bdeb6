"""A RealSense without the glass: the SDK's own software device, with the options and the clock of a D435's
colour sensor.

As a program it is the node `realsense_camera` on such a device; SIGUSR1 unplugs it, SIGUSR2 plugs it in
again.
"""

import signal
import threading
import time

import numpy as np
import pyrealsense2 as rs

from np_perception.camera.source import CameraError

PERIOD = 1 / 30
WIDTH, HEIGHT = 1280, 720


def picture() -> np.ndarray:
    """A smooth picture: every place has another colour."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([u * 255 // WIDTH, v * 255 // HEIGHT, (u + v) * 255 // (WIDTH + HEIGHT)], axis=2).astype(np.uint8)


class SoftwareCamera:
    """device: the SDK's; push sends one frame with the camera's time in ms."""

    def __init__(
        self,
        *,
        leave_out=(),
        stubborn=(),
        model=rs.distortion.inverse_brown_conrady,
        coefficients=(0.05, -0.06, 1e-4, -2e-4, 0.0),
        size=(WIDTH, HEIGHT),
    ) -> None:
        self.device = rs.software_device()
        self.device.register_info(rs.camera_info.name, "Software D435")
        self.device.register_info(rs.camera_info.serial_number, "0815")
        self.sensor = self.device.add_sensor("RGB Camera")
        option = rs.option
        for which, low, high, value in (
            (option.enable_auto_exposure, 0, 1, 1),
            (option.enable_auto_white_balance, 0, 1, 1),
            (option.exposure, 1, 10000, 156),
            (option.gain, 0, 128, 64),
            (option.white_balance, 2800, 6500, 4600),
            (option.global_time_enabled, 0, 1, 1),
        ):
            if which in leave_out:
                continue
            span = rs.option_range()
            span.min, span.max, span.step, span.default = low, high, 1, value
            if which in stubborn:
                self.sensor.add_read_only_option(which, value)
            else:
                self.sensor.add_option(which, span, True)
        intrinsics = rs.intrinsics()
        intrinsics.width, intrinsics.height = size
        intrinsics.fx, intrinsics.fy, intrinsics.ppx, intrinsics.ppy = 918.0, 917.0, 641.0, 357.0
        intrinsics.model, intrinsics.coeffs = model, list(coefficients)
        stream = rs.video_stream()
        stream.type, stream.index, stream.uid, stream.fmt, stream.fps, stream.bpp = (
            rs.stream.color,
            0,
            1,
            rs.format.rgb8,
            30,
            3,
        )
        stream.width, stream.height = size
        stream.intrinsics = intrinsics
        self.sensor.add_video_stream(stream)
        self._profile = self.sensor.get_stream_profiles()[0].as_video_stream_profile()
        self._pixels = picture() if size == (WIDTH, HEIGHT) else np.zeros((size[1], size[0], 3), np.uint8)
        self._number = 0

    def push(
        self,
        milliseconds: float,
        *,
        domain=rs.timestamp_domain.hardware_clock,
        exposed_us: int | None = None,
        lost: int = 0,
    ) -> None:
        """One frame; exposed_us: how long before its own time the middle of its exposure was; lost: frames
        before it."""
        self._number += 1 + lost
        frame = rs.software_video_frame()
        frame.profile, frame.pixels, frame.stride, frame.bpp = (
            self._profile,
            self._pixels,
            3 * self._pixels.shape[1],
            3,
        )
        frame.timestamp, frame.domain, frame.frame_number = milliseconds, domain, self._number
        if exposed_us is not None:
            stamp = int(1000 * milliseconds)
            self.sensor.set_metadata(rs.frame_metadata_value.frame_timestamp, stamp)
            self.sensor.set_metadata(rs.frame_metadata_value.sensor_timestamp, stamp - exposed_us)
        self.sensor.on_video_frame(frame)


def main() -> int:
    """The node on a software camera that takes 30 images a second while it is plugged in."""
    from np_franka.nodes.realsense_camera_node import RealSenseCamera
    from np_ros.node import run

    plugged, ended = threading.Event(), threading.Event()
    cameras: list[SoftwareCamera] = []

    def find(serial: str):
        if not plugged.is_set():
            raise CameraError(f"camera: expected a RealSense with serial number {serial}, found none")
        cameras.append(SoftwareCamera())  # what is plugged in again is another device
        return cameras[-1].device

    def shoot() -> None:
        while not ended.wait(PERIOD):
            if plugged.is_set() and cameras:
                cameras[-1].push(1e3 * time.monotonic())

    plugged.set()
    signal.signal(signal.SIGUSR1, lambda *_: plugged.clear())
    signal.signal(signal.SIGUSR2, lambda *_: plugged.set())
    shooter = threading.Thread(target=shoot)
    shooter.start()
    try:
        return run(lambda: RealSenseCamera(find))
    finally:
        ended.set()
        shooter.join()


if __name__ == "__main__":
    raise SystemExit(main())
