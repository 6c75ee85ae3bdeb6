"""Pictures of a video by their time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from np_record.lerobot.layout import DataSetError

_AHEAD = 1.0  # s before the first picture that is looked for: where a seek lands depends on the video's key frames


def read_pictures(path: Path, times: np.ndarray, tolerance: float) -> Iterator[np.ndarray]:
    """The picture (height, width, 3) uint8 RGB of each of the times (n,) s from the video's start, which increase.

    Raises DataSetError where a video cannot be decoded, or has no picture within `tolerance` s of a time.
    """
    frames = _frames(path, float(times[0]) - tolerance)
    found = None
    for time in times:
        while found is None or found[0] < time - tolerance:
            last, found = found, next(frames, None)
            if found is None:
                end = "none" if last is None else f"its last is of {last[0]:.3f} s"
                raise DataSetError(f"video {path}: expected a picture of {time:.3f} s, {end}")
        if found[0] > time + tolerance:
            raise DataSetError(f"video {path}: expected a picture of {time:.3f} s, the next is of {found[0]:.3f} s")
        yield np.ascontiguousarray(found[1][..., ::-1])


def _frames(path: Path, begin: float) -> Iterator[tuple[float, np.ndarray]]:
    """(time s, BGR picture) of a video from `begin` s or earlier."""
    reader = cv2.VideoCapture(str(path))
    try:
        if not reader.isOpened():
            raise DataSetError(
                f"video {path}: expected a video, {'none that opens' if path.exists() else 'no such file'}"
            )
        codec = int(reader.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode("latin-1").strip("\0 ")
        reader.set(cv2.CAP_PROP_POS_MSEC, 1e3 * max(0.0, begin - _AHEAD))
        is_there, picture = reader.read()
        if is_there and reader.get(cv2.CAP_PROP_POS_MSEC) > 1e3 * begin:
            reader.set(cv2.CAP_PROP_POS_MSEC, 0.0)
            is_there, picture = reader.read()
        if not is_there:
            hint = ": make it again as H.264 or VP9" if codec.lower() == "av01" else ""
            raise DataSetError(
                f"video {path}: expected one that this OpenCV decodes, got codec {codec or 'unknown'}{hint}"
            )
        while is_there:
            yield reader.get(cv2.CAP_PROP_POS_MSEC) / 1e3, picture
            is_there, picture = reader.read()
    finally:
        reader.release()
