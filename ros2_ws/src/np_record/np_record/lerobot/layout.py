"""Where a LeRobot data set of format v3.0 has what, and how a feature is called here.

The format: https://huggingface.co/docs/lerobot/lerobot-dataset-v3. It packs many episodes in a file. meta/episodes
gives the rows of which table, and the seconds of which video, that belong to each episode.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

VERSION = "v3.0"
INFO, STATS, TASKS = "meta/info.json", "meta/stats.json", "meta/tasks.parquet"
EPISODES = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
FIRST = {"chunk_index": 0, "file_index": 0}

STATE = "observation.state"
KEYPOINTS = "observation.keypoints"
OBJECT = (
    "observation.environment_state"  # LeRobot's own name for state that a simulator has and a robot does not measure
)
GOAL = "observation.goal"
CAMERA_IMAGE = "observation.images.camera"
ACTION = "action"
TORQUE = "command.effort"
TARGET = "policy.target"
PHASE = "phase"
DONE, SUCCESS = "next.done", "next.success"


class DataSetError(ValueError):
    """A data set that cannot be written or read; the text states what was expected and what came."""


@dataclass(frozen=True)
class Clip:
    """Part of a video."""

    path: Path
    """The video."""
    begin: float
    """s from its start."""
    end: float
    """s, likewise."""


@dataclass(frozen=True)
class DataSetEpisode:
    """One episode of a data set."""

    tasks: tuple[str, ...]
    """What was to be done."""
    begin: int
    """Its first row in the columns."""
    end: int
    """The row after its last."""
    clips: Mapping[str, Clip]
    """Where its pictures are, by feature."""

    @property
    def rows(self) -> slice:
        """Its part of a column."""
        return slice(self.begin, self.end)


def parquet():
    """The modules pyarrow and pyarrow.parquet. Raises DataSetError where they are not installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise DataSetError("expected the package pyarrow, it is not installed: `make lerobot` adds it") from error
    return pyarrow, pyarrow.parquet
