"""The colour stream of a RealSense camera, through its maker's SDK (pyrealsense2, from the hardware extra).

Exposure, gain and white balance are fixed: a detector that learned with one brightness should not meet a
camera that changes it when the arm comes into view. Frames are stamped by the camera's own clock, mapped to
the host's.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from np_description.calibration import Lens
from np_perception.camera.frame_clock import ClockMapper
from np_perception.camera.source import CameraError, CameraFrame

# Ns: the camera counts microseconds in 32 bits, and begins anew every 71.6 minutes
COUNTER_WRAPS = 2**32 * 1000
EXPOSURE_UNIT = 1e-4  # s, of the colour sensor's option (librealsense: "exposure" of RGB sensors is in 100 us)
LONGEST_READOUT = 200_000  # us, from the middle of an exposure to the frame's own stamp; more is no such pair of times
_QUEUE = 2  # frames that may wait: older ones are dropped by the SDK
_SETTLING = 10  # frames after the start that are not used: exposure and clock settle


@dataclass(frozen=True)
class RealSenseSettings:
    """width, height px and rate Hz: of the stream. exposure s, gain (the SDK's units), white_balance K.
    latency s: what the stamps are to be earlier, for the least delay that no clock can see."""

    width: int = 1280
    height: int = 720
    rate: int = 30
    exposure: float = 0.008
    gain: float = 64.0
    white_balance: float = 4600.0
    latency: float = 0.0


def sdk():
    """The module pyrealsense2. Raises CameraError where the hardware extra is not installed."""
    try:
        import pyrealsense2
    except ImportError as error:
        raise CameraError(
            f"camera: expected the package pyrealsense2 ({error}); `make hardware` installs it"
        ) from error
    return pyrealsense2


def find_device(serial: str = ""):
    """The camera with this serial number, or the only one there is. Raises CameraError."""
    rs = sdk()
    devices = {device.get_info(rs.camera_info.serial_number): device for device in rs.context().query_devices()}
    if serial in devices:
        return devices[serial]
    wanted = f"with serial number {serial}" if serial else "and only one"
    if serial or len(devices) != 1:
        raise CameraError(
            f"camera: expected a RealSense {wanted}, found {', '.join(sorted(devices)) or 'none'}: "
            "look at the cable, at `lsusb`, and at the udev rules (docs/guide/hardware.md)"
        )
    return next(iter(devices.values()))


class RealSense:
    """An opened colour stream: a np_perception.camera.source.CameraSource. Raises CameraError if the camera cannot
    do it."""

    def __init__(self, device, settings: RealSenseSettings = RealSenseSettings()) -> None:
        self._rs = rs = sdk()
        self._settings = settings
        self._clock = ClockMapper(COUNTER_WRAPS)
        self._unused = _SETTLING
        self._number: int | None = None
        self.turn, self.period = np.eye(3), 1 / settings.rate
        self._queue = rs.frame_queue(_QUEUE)
        try:
            self.values: dict[str, object] = {
                "camera": _information(device, rs.camera_info.name),
                "serial number": _information(device, rs.camera_info.serial_number),
                "firmware": _information(device, rs.camera_info.firmware_version),
                "usb": _information(device, rs.camera_info.usb_type_descriptor),
                "frames missed": 0,
            }
            self._sensor, profile = self._find(device)
            self._fix()
            self.lens = lens_of(profile.get_intrinsics(), rs)
            self._sensor.open(profile)
            self._sensor.start(self._queue)
        except RuntimeError as error:  # the SDK's only exception
            raise CameraError(f"camera: {error}") from error

    def _find(self, device):
        """The sensor and profile of the requested stream."""
        rs, wanted, offered = self._rs, self._settings, []
        for sensor in device.query_sensors():
            for profile in sensor.get_stream_profiles():
                if profile.stream_type() != rs.stream.color or profile.format() != rs.format.rgb8:
                    continue
                video = profile.as_video_stream_profile()
                if (video.width(), video.height(), video.fps()) == (wanted.width, wanted.height, wanted.rate):
                    return sensor, video
                offered.append(f"{video.width()} x {video.height()} at {video.fps()}")
        raise CameraError(
            f"camera: expected an rgb8 colour stream of {wanted.width} x {wanted.height} at {wanted.rate} Hz,"
            f" it offers {', '.join(offered) or 'no colour'} (over USB 2 a camera offers less)"
        )

    def _fix(self) -> None:
        """No automatic anything; what was set is read back."""
        option, wanted = self._rs.option, self._settings
        self._set(option.enable_auto_exposure, 0)
        self._set(option.enable_auto_white_balance, 0, required=False)
        self._set(option.auto_exposure_priority, 0, required=False)  # or the rate falls in dim light
        # Else the SDK maps the clock, with its own idea of outliers.
        self._set(option.global_time_enabled, 0, required=False)
        self._set(option.exposure, round(wanted.exposure / EXPOSURE_UNIT))
        self._set(option.gain, wanted.gain, required=False)
        self._set(option.white_balance, wanted.white_balance, required=False)

    def _set(self, option, value: float, required: bool = True) -> None:
        if not self._sensor.supports(option):
            if required:
                raise CameraError(f"camera: expected a colour sensor with the option {option}, it has none")
            return
        self._sensor.set_option(option, value)
        if (got := self._sensor.get_option(option)) != value:
            raise CameraError(f"camera: option {option}: set to {value:g}, it reads {got:g}")

    def read(self, timeout: float) -> CameraFrame | None:
        """See Source."""
        try:
            came, frame = self._queue.try_wait_for_frame(max(1, round(1e3 * timeout)))
            arrival = time.time_ns()
            if not came:
                return None
            stamp = self._stamp(frame, arrival)
            pixels = np.asanyarray(frame.as_video_frame().get_data())
        except RuntimeError as error:
            raise CameraError(f"camera: {error}") from error
        if self._unused:
            self._unused -= 1
            return None
        return CameraFrame(stamp, pixels)

    def _stamp(self, frame, arrival: int) -> int:
        """When the frame was taken, ns of the host's clock; the middle of the exposure where the camera reports
        it."""
        rs, domain = self._rs, frame.get_frame_timestamp_domain()
        taken = round(frame.get_timestamp() * 1e6)
        metadata = rs.frame_metadata_value
        if frame.supports_frame_metadata(metadata.sensor_timestamp) and frame.supports_frame_metadata(
            metadata.frame_timestamp
        ):
            since = frame.get_frame_metadata(metadata.frame_timestamp) - frame.get_frame_metadata(
                metadata.sensor_timestamp
            )
            since %= 2**32  # us: both are counters of 32 bits
            taken -= 1000 * since if since < LONGEST_READOUT else 0
        number = frame.get_frame_number()
        if self._number is not None and number > self._number + 1:
            self.values["frames missed"] += number - self._number - 1
        self._number = number
        if domain == rs.timestamp_domain.hardware_clock:
            stamp = self._clock.map(taken, arrival)
            self.values.update(
                {
                    "clock drift ppm": f"{1e6 * self._clock.drift:.1f}",
                    "clock restarts": self._clock.restarts,
                    "clock": "hardware",
                    "delay ms": f"{1e-6 * (arrival - stamp):.1f}",
                }
            )
        else:  # without the kernel's metadata the SDK stamps on arrival: later than the truth, and not evenly
            stamp = min(taken, arrival)
            self.values["clock"] = f"{domain}: no hardware time, stamps are those of arrival"
        return stamp - round(1e9 * self._settings.latency)

    def close(self) -> None:
        """See Source."""
        for step in (self._sensor.stop, self._sensor.close):
            try:
                step()
            except RuntimeError:
                pass  # it has gone already


def lens_of(intrinsics, rs) -> Lens:
    """The SDK's intrinsics as ours. Raises CameraError for a model of distortion that is not Brown and
    Conrady's.

    What the SDK calls Inverse Brown-Conrady is the ordinary model with OpenCV's order of coefficients. It is so in
    the SDK's own projection since 2021 and by measurement on cameras (librealsense issue 13824). Tests compare ours
    with the SDK's deprojection.
    """
    coefficients, model = tuple(map(float, intrinsics.coeffs)), intrinsics.model
    if model == rs.distortion.none or not any(coefficients):
        coefficients = (0.0,) * 5
    elif model not in (rs.distortion.brown_conrady, rs.distortion.inverse_brown_conrady):
        raise CameraError(f"camera: expected (inverse) Brown-Conrady distortion, got {model} with {coefficients}")
    return Lens(
        intrinsics.width,
        intrinsics.height,
        intrinsics.fx,
        intrinsics.fy,
        intrinsics.ppx,
        intrinsics.ppy,
        coefficients,
    )


def _information(device, key) -> str:
    return device.get_info(key) if device.supports(key) else ""
