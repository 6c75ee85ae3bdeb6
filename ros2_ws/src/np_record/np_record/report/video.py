"""A video of an episode: the camera's images with goal, detected keypoints and phase drawn in; beside them arm and object as seen from the side.

WebM with VP8, which every current browser plays and OpenCV's wheels encode.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from np_description.camera import CAMERA
from np_description.domains import Pose
from np_description.keypoints import box_keypoints
from np_description.scene import CORNER_COLOURS
from np_record.recorded_episode import EpisodeData, Series
from np_record.report.third_person import ThirdPerson

SCALE = 2  # pixels of the video for one of the camera
_EDGES = [(a, a | bit) for a in range(8) for bit in (1, 2, 4) if not a & bit]
_GREEN, _WHITE = (90, 230, 90), (255, 255, 255)


def write_video(path: str | Path, episode: EpisodeData, images: Iterable[tuple[float, np.ndarray]], rate: float) -> int:
    """Write images (time s, pixels) at `rate` frames a second; the number of frames written.

    Raises OSError where OpenCV cannot encode. With no images no file is made.
    """
    beside = ThirdPerson(episode.domain, SCALE * CAMERA.height)
    return encode(
        path,
        (np.hstack([annotate(pixels, episode, t), draw_from_side(beside, episode, t)]) for t, pixels in images),
        rate,
    )


def encode(path: str | Path, frames: Iterable[np.ndarray], rate: float, codec: str = "VP80") -> int:
    """Write frames (height, width, 3) uint8 RGB at `rate` a second; as `write_video` otherwise. codec: its FourCC."""
    writer, count = None, 0
    try:
        for frame in frames:
            if writer is None:
                size = (frame.shape[1], frame.shape[0])
                with _quiet():
                    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*codec), rate, size)
                if not writer.isOpened():
                    raise OSError(f"video {path}: expected OpenCV with an encoder for {codec}, it cannot open one")
            writer.write(np.ascontiguousarray(frame[..., ::-1]))
            count += 1
    finally:
        if writer is not None:
            writer.release()
    return count


def annotate(pixels: np.ndarray, episode: EpisodeData, time: float) -> np.ndarray:
    """The image of `time` s, enlarged, with goal outline, keypoints and a line of text; RGB uint8."""
    frame = cv2.resize(pixels, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_CUBIC)
    draw_box(frame, episode.goal, episode.domain.half_size)
    for (u, v, score), colour in zip(_latest(episode.keypoints, time, np.empty((0, 3))), CORNER_COLOURS):
        colour = tuple(int(255 * c) for c in colour)
        cv2.circle(frame, _pixel((u, v)), 4, _WHITE, 1 if score < 0.3 else cv2.FILLED, cv2.LINE_AA)
        cv2.circle(frame, _pixel((u, v)), 3, colour, 1 if score < 0.3 else cv2.FILLED, cv2.LINE_AA)
    phase = next((state.phase for start, state in reversed(episode.phases) if start <= time), "")
    distance, angle = _latest(episode.distance, time, np.nan), _latest(episode.angle, time, np.nan)
    text = f"{time:5.1f} s  {phase:9s} {100 * distance:5.1f} cm {np.degrees(angle):5.0f} deg"
    cv2.rectangle(frame, (0, 0), (frame.shape[1], 22), (30, 30, 30), cv2.FILLED)
    cv2.putText(frame, text, (8, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _WHITE, 1, cv2.LINE_AA)
    return frame


def draw_from_side(beside: ThirdPerson, episode: EpisodeData, time: float) -> np.ndarray:
    """Arm, object and goal at `time` s; RGB uint8."""
    place = _latest(episode.object_position, time, None)
    turn = _latest(episode.object_quaternion, time, None)
    body = None if place is None or turn is None else Pose(place, turn)
    return beside.picture(_latest(episode.position, time, episode.position.values[0]), body, episode.goal)


def draw_box(frame: np.ndarray, pose: Pose, half_size) -> None:
    """Outline a box of half size (3,) m at a pose in an image of the nominal camera, enlarged by SCALE."""
    corners = CAMERA.project(box_keypoints(np.asarray(half_size), pose.position, pose.quaternion))[0]
    for a, b in _EDGES:
        cv2.line(frame, _pixel(corners[a]), _pixel(corners[b]), _GREEN, 1, cv2.LINE_AA)


def _pixel(uv) -> tuple[int, int]:
    return int(round((uv[0] + 0.5) * SCALE - 0.5)), int(round((uv[1] + 0.5) * SCALE - 0.5))


def _latest(series: Series, time: float, default):
    index = int(np.searchsorted(series.time, time + 1e-6)) - 1
    return series.values[index] if index >= 0 else default


@contextmanager
def _quiet():
    """FFmpeg prints on file descriptor 2 that WebM has no tags, which is so."""
    saved, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(null)
