"""Images from a bag or a folder in a camera's place: a np_perception.camera.source.CameraSource."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import yaml

from np_description.calibration import Lens
from np_description.camera import CAMERA
from np_description.message_arrays import image_array
from np_perception.camera.recorded_lens import read_lenses
from np_perception.camera.source import CameraError, CameraFrame, EndOfImages
from np_record.bag import BagError, Recording

LENS_FILE = "camera.yaml"
STAMPS = ("now", "recorded")
POLICY_LENS = Lens(CAMERA.width, CAMERA.height, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)


class BagImages:
    """The images of a bag: (stamp ns, pixels) in order. Raises CameraError for a bag without any, or a broken
    one."""

    def __init__(self, path: str | Path) -> None:
        try:
            with Recording(path, required=("camera/image_raw",)) as recording:
                self.lens, self.turn = next(read_lenses(recording), (POLICY_LENS, np.eye(3)))
                stamps = [message.stamp for message in recording.messages("camera/image_raw")]
        except BagError as error:
            raise CameraError(str(error)) from error
        self.longest_gap = float(np.diff(stamps).max() / 1e9) if len(stamps) > 1 else 0.0
        self._path, self._count = path, len(stamps)

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[CameraFrame]:
        try:
            with Recording(self._path, required=("camera/image_raw",)) as recording:
                for stamp, pixels in recording.read("camera/image_raw", image_array):
                    yield CameraFrame(stamp, pixels)
        except BagError as error:
            raise CameraError(str(error)) from error


class FolderImages:
    """The pictures of a folder, PNG or JPEG, in the order of their names.

    A file camera.yaml beside them describes the camera: fx, fy, cx, cy px, distortion (5), rate Hz; without it
    they must be images as the policies see them, and 30 a second. A name that is a number is the stamp, in
    ns. Raises CameraError.
    """

    def __init__(self, path: str | Path) -> None:
        folder = Path(path)
        self._files = sorted(p for p in folder.iterdir() if p.suffix.lower() in (".png", ".jpg", ".jpeg"))
        if not self._files:
            raise CameraError(f"folder {folder}: expected PNG or JPEG pictures, found none")
        height, width = self._read(self._files[0]).shape[:2]
        rate, self.lens, self.turn = 30.0, POLICY_LENS, np.eye(3)
        if (folder / LENS_FILE).exists():
            rate, self.lens = _read_lens(folder / LENS_FILE, width, height)
        elif (width, height) != (CAMERA.width, CAMERA.height):
            raise CameraError(
                f"folder {folder}: expected {CAMERA.width} x {CAMERA.height} pictures, or {LENS_FILE} that"
                f" describes the camera, got {width} x {height}"
            )
        numbers = [file.stem.isdecimal() for file in self._files]
        if all(numbers):
            self._files.sort(key=lambda file: int(file.stem))
            self._stamps = [int(file.stem) for file in self._files]
        elif any(numbers):
            raise CameraError(
                f"folder {folder}: expected stamps as names of all pictures or of none, "
                f"got {self._files[numbers.index(False)].name}"
            )
        else:
            self._stamps = [round(i * 1e9 / rate) for i in range(len(self._files))]
        self.longest_gap = float(np.diff(self._stamps).max() / 1e9) if len(self._stamps) > 1 else 0.0

    def __len__(self) -> int:
        return len(self._files)

    def __iter__(self) -> Iterator[CameraFrame]:
        for stamp, file in zip(self._stamps, self._files):
            yield CameraFrame(stamp, self._read(file))

    @staticmethod
    def _read(file: Path) -> np.ndarray:
        image = cv2.imread(str(file), cv2.IMREAD_COLOR)
        if image is None:
            raise CameraError(f"picture {file}: expected PNG or JPEG, it cannot be read")
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _read_lens(file: Path, width: int, height: int) -> tuple[float, Lens]:
    try:
        content = dict(yaml.safe_load(file.read_text()))
        rate = float(content.pop("rate", 30.0))
        content["distortion"] = tuple(map(float, content.get("distortion", (0.0,) * 5)))
        if not 0 < rate <= 1000:
            raise ValueError(f"rate: expected 0 .. 1000 Hz, got {rate}")
        return rate, Lens(width, height, **content)
    except (OSError, TypeError, ValueError, yaml.YAMLError) as error:  # a CalibrationError is a ValueError
        problem = " ".join(str(error).split())
        raise CameraError(f"{file}: expected fx, fy, cx, cy and optionally distortion and rate: {problem}") from error


class Playback:
    """Plays a bag or a folder at `rate` times its own pace.

    stamps "now": those of the time at which an image is played, "recorded": its own; repeat: begin anew at
    the end, for stamps of now only. Raises CameraError if there is nothing to play.
    """

    def __init__(self, path: str | Path, *, rate: float = 1.0, stamps: str = "now", repeat: bool = False) -> None:
        if repeat and stamps != "now":
            raise CameraError("playback: expected stamps of now where images are repeated: time cannot run backwards")
        path = Path(path)
        if not path.exists():
            raise CameraError(f"playback: expected a bag or a folder with pictures, {path} does not exist")
        is_folder = path.is_dir() and not (path / "metadata.yaml").exists() and not list(path.glob("*.mcap"))
        self._images = FolderImages(path) if is_folder else BagImages(path)
        self._path, self._rate, self._now, self._repeat = path, rate, stamps == "now", repeat
        self.lens, self.turn = self._images.lens, self._images.turn
        self.period = self._images.longest_gap / rate
        self.values: dict[str, object] = {"source": str(path), "images there": len(self._images)}
        self._frames = iter(self._images)
        self._next: CameraFrame | None = None
        self._began: tuple[int, int, int] | None = None  # stamp of the first image; when it was played, two clocks

    def read(self, timeout: float) -> CameraFrame | None:
        """See Source."""
        frame = self._next = self._next or self._take()
        if self._began is None:
            self._began = frame.stamp, time.monotonic_ns(), time.time_ns()
        first, monotonic, host = self._began
        since = round((frame.stamp - first) / self._rate)
        wait = (monotonic + since - time.monotonic_ns()) * 1e-9
        time.sleep(min(max(wait, 0.0), timeout))
        if wait > timeout:
            return None
        self._next = None
        return CameraFrame(host + since, frame.pixels) if self._now else frame

    def _take(self) -> CameraFrame:
        frame = next(self._frames, None)
        if frame is None and self._repeat:
            self._frames, self._began = iter(self._images), None
            frame = next(self._frames, None)
        if frame is None:
            raise EndOfImages(f"played the {len(self._images)} images of {self._path}")
        return frame

    def close(self) -> None:
        """See Source."""
        self._frames = iter(())
