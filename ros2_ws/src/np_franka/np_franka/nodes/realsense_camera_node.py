"""`realsense_camera`: the colour stream of a RealSense as the images that the policies learned with."""

from __future__ import annotations

from collections.abc import Callable

from np_franka.realsense import RealSense, RealSenseSettings, find_device
from np_perception.nodes.camera import CameraNode
from np_ros.node import parameter, run


class RealSenseCamera(CameraNode):
    """The camera with a serial number, opened anew whenever it has gone. find: gives the SDK's device of a
    serial number."""

    def __init__(self, find: Callable = find_device) -> None:
        super().__init__("realsense_camera")
        serial = parameter(self, "serial_number", "", "Of the camera; empty: the only one there is.")
        default = RealSenseSettings()
        settings = RealSenseSettings(
            parameter(self, "width", default.width, "Of the camera's images, px.", 320, 3840),
            parameter(self, "height", default.height, "Of the camera's images, px.", 240, 2160),
            parameter(self, "rate", default.rate, "Images a second.", 1, 90),
            parameter(self, "exposure", default.exposure, "Of every image, s.", 1e-4, 0.165),
            parameter(self, "gain", default.gain, "Of the colour sensor, in the camera's units.", 0.0, 248.0),
            parameter(self, "white_balance", default.white_balance, "Temperature of the light, K.", 2000.0, 10000.0),
            parameter(
                self,
                "latency",
                default.latency,
                "What stamps are made earlier by, s: the least delay of an image.",
                0.0,
                0.2,
            ),
        )
        self.begin(lambda: RealSense(find(serial), settings))


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable `realsense_camera`."""
    return run(RealSenseCamera, args)


if __name__ == "__main__":
    raise SystemExit(main())
