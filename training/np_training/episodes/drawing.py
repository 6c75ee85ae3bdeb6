"""Recorded episodes drawn on the CPU: the scene's camera, the goal's outline, how it ended."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from np_description.domains import Pose, Task, find_domain, pose_error
from np_description.scene import load_model
from np_record.report.video import SCALE, draw_box, encode
from np_sim_bridge.renderer import Renderer, make_renderer
from np_training.episodes.recording import PERIOD, RecordedEpisodes, load_recording

LINGER = 10  # frames of the end
_WHITE, _DARK = (255, 255, 255), (30, 30, 30)


def frames(renderer: Renderer, domain: Task, recording: RecordedEpisodes, row: int) -> Iterator[np.ndarray]:
    """Pictures (height, width, 3) uint8 RGB of an episode, one a policy step, and of its end for a while."""
    goal = Pose(recording.goals[row, :3], recording.goals[row, 3:])
    last = int(recording.length[row])
    for step in [*range(last + 1), *[last] * LINGER]:
        qpos = recording.qpos[step, row]
        frame = cv2.resize(renderer.render(qpos), None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_CUBIC)
        draw_box(frame, goal, domain.half_size)
        distance, angle = pose_error(qpos[9:12], qpos[12:16], goal.position, goal.quaternion)
        ended = str(recording.mode[row]) if step == last else ""
        text = (
            f"{row:4d}  {step * PERIOD:4.1f} s  {100 * distance:5.1f} cm {np.degrees(angle):4.0f} deg  "
            f"{int(recording.tips[row])} turns  {ended}"
        )
        cv2.rectangle(frame, (0, 0), (frame.shape[1], 22), _DARK, cv2.FILLED)
        cv2.putText(frame, text, (8, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _WHITE, 1, cv2.LINE_AA)
        yield frame


def draw_recording(path: Path, out: Path, count: int) -> list[Path]:
    """Draw `count` episodes of a recording, half of them failures where there are as many; one file an
    episode.

    Raises ValueError where the recording has no episode that was played.
    """
    recording = load_recording(path)
    rows = recording.choose(count)
    if not len(rows):
        raise ValueError(f"recording {path}: expected an episode that was played, every contact was out of reach")
    domain = find_domain(recording.domain)
    drawing = make_renderer("auto", load_model(domain))
    out.mkdir(parents=True, exist_ok=True)
    files = []
    for row in rows:
        file = out / f"{recording.domain}_{row:04d}_{recording.mode[row]}.webm"
        encode(file, frames(drawing, domain, recording, row), 1 / PERIOD)
        files.append(file)
    drawing.close()
    return files
