"""`camera_player`: images from a bag or a folder, as if a camera saw them now."""

from __future__ import annotations

from np_perception.camera.playback import STAMPS, Playback
from np_perception.nodes.camera import CameraNode
from np_ros.node import parameter, run


class CameraPlayer(CameraNode):
    """Plays once or again and again, through the same rectification as a camera's images."""

    def __init__(self) -> None:
        super().__init__("camera_player")
        source = parameter(self, "source", "", "Bag, or folder with pictures.")
        rate = parameter(self, "rate", 1.0, "How many times as fast as recorded.", 0.01, 100.0)
        stamps = parameter(
            self, "stamps", "now", "now: as if taken when played; recorded: as they were.", choices=STAMPS
        )
        repeat = parameter(self, "repeat", False, "Whether to begin anew at the end; with stamps of now only.")
        subscribers = parameter(self, "subscribers", 1, "Subscribers to the images that are waited for first.", 0, 100)
        if not source:
            raise ValueError("parameter source: expected a bag or a folder with pictures, got none")
        self.begin(lambda: Playback(source, rate=rate, stamps=stamps, repeat=repeat), subscribers, retry=False)


def main(args=None):
    """Run the node until SIGINT or SIGTERM."""
    return run(CameraPlayer, args)


if __name__ == "__main__":
    raise SystemExit(main())
