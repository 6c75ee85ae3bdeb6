"""Recorded episodes written as a LeRobot data set: one table, one video, and the rows of them that belong to each episode."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from np_description.camera import CAMERA
from np_record.bag import BagError, Recording
from np_record.lerobot import layout
from np_record.lerobot.frames import NAMES, RATE, EpisodeFrames, read_episode_frames
from np_record.lerobot.layout import CAMERA_IMAGE, DataSetError, parquet
from np_record.lerobot.statistics import sample_pixels, summarize, summarize_images
from np_record.report.video import encode

ROBOT = "franka_panda"
_DTYPES = {layout.PHASE: "int64", layout.DONE: "bool", layout.SUCCESS: "bool"}  # of the others: float32
_BOOKKEEPING = ("timestamp", "frame_index", "episode_index", "index", "task_index")
_CODEC = "vp09"  # VP9 in MP4: OpenCV's wheels encode it, browsers and LeRobot's decoders read it
_LIMITS = {"chunks_size": 1000, "data_files_size_in_mb": 100, "video_files_size_in_mb": 200}
_SHAPE = (CAMERA.height, CAMERA.width, 3)


def write_data_set(
    root: str | Path, bags: Sequence[str | Path], show: Callable[[int], None] = lambda done: None
) -> dict:
    """Write the first episode of each bag to the new folder `root`; the data set's information (meta/info.json).

    show: called with the number of bags done. Raises DataSetError where the folder exists, pyarrow is missing, or an
    episode has other features than the first; BagError for a bag without an episode; OSError.
    """
    root = Path(root)
    parquet()
    if root.exists():
        raise DataSetError(f"data set {root}: expected a new folder, it exists")
    episodes = _Episodes(root)
    try:
        # The table is small and kept until all is known; pictures go to the encoder as they come.
        encode(episodes.video, episodes.pictures(bags, show), RATE, _CODEC)
        return episodes.close()
    except BaseException:
        shutil.rmtree(root, ignore_errors=True)  # half a data set would be in the way of the next call
        raise


class _Episodes:
    """What has been read so far, and the files that describe it."""

    def __init__(self, root: Path):
        self._root = root
        self.video = root / layout.VIDEO.format(video_key=CAMERA_IMAGE, **layout.FIRST)
        self._about: list[dict] = []  # rows of meta/episodes
        self._columns: list[dict[str, np.ndarray]] = []
        self._pixels: list[np.ndarray] = []
        self._tasks: list[str] = []
        self._frames = 0

    def pictures(self, bags: Sequence[str | Path], show: Callable[[int], None]) -> Iterator[np.ndarray]:
        """The images of all episodes, one after the other; what else they have is kept."""
        for number, bag in enumerate(bags):
            with Recording(bag) as recording:
                frames = read_episode_frames(recording)
            self._add(frames, str(bag))
            for image in frames.images:
                self.video.parent.mkdir(parents=True, exist_ok=True)
                yield image
            show(number + 1)

    def _add(self, frames: EpisodeFrames, bag: str) -> None:
        if len(frames.images) and frames.images.shape[1:] != _SHAPE:
            raise DataSetError(f"bag {bag}: expected images of shape {_SHAPE}, got {frames.images.shape[1:]}")
        if self._columns:
            expected = {*self._columns[0], *([CAMERA_IMAGE] if len(self._pixels[0]) else [])} - {*_BOOKKEEPING}
            got = {*frames.columns, *([CAMERA_IMAGE] if len(frames.images) else [])}
            if got != expected:
                other = ", ".join(sorted(got ^ expected))
                raise DataSetError(f"bag {bag}: expected the features of the bags before it; they differ in {other}")
        if frames.task not in self._tasks:
            self._tasks.append(frames.task)
        count, number = len(frames), len(self._about)
        steps = np.arange(count)
        columns = {
            **frames.columns,
            "timestamp": steps / RATE,
            "frame_index": steps,
            "episode_index": np.full(count, number),
            "index": self._frames + steps,
            "task_index": np.full(count, self._tasks.index(frames.task)),
        }
        columns = {name: values.reshape(count, -1) for name, values in columns.items()}
        pixels = sample_pixels(frames.images) if len(frames.images) else frames.images
        begin, self._frames = self._frames, self._frames + count
        self._columns.append(columns)
        self._pixels.append(pixels)
        about = {
            "episode_index": number,
            "tasks": [frames.task],
            "length": count,
            "dataset_from_index": begin,
            "dataset_to_index": self._frames,
            "bag": Path(bag).name,
        }
        for place in ("data", "meta/episodes", *([f"videos/{CAMERA_IMAGE}"] if len(pixels) else [])):
            about |= {f"{place}/{key}": value for key, value in layout.FIRST.items()}
        if len(pixels):
            about |= {
                f"videos/{CAMERA_IMAGE}/from_timestamp": begin / RATE,
                f"videos/{CAMERA_IMAGE}/to_timestamp": self._frames / RATE,
            }
        for feature, summary in _statistics(columns, pixels).items():
            about |= {f"stats/{feature}/{name}": value for name, value in summary.items()}
        self._about.append(about)

    def close(self) -> dict:
        """Write tables, statistics and, last, the information that makes a folder a data set; the information."""
        if not self._about:
            raise BagError("expected one bag or more, got none")
        arrow, _ = parquet()
        columns = {name: np.concatenate([part[name] for part in self._columns]) for name in self._columns[0]}
        pixels = np.concatenate(self._pixels)
        self._write(layout.DATA.format(**layout.FIRST), arrow.table({n: _column(n, v) for n, v in columns.items()}))
        self._write(layout.EPISODES.format(**layout.FIRST), arrow.Table.from_pylist(self._about))
        self._write(layout.TASKS, _task_table(self._tasks))
        (self._root / layout.STATS).write_text(json.dumps(_statistics(columns, pixels), indent=1))
        information = {
            "codebase_version": layout.VERSION,
            "robot_type": ROBOT,
            "total_episodes": len(self._about),
            "total_frames": self._frames,
            "total_tasks": len(self._tasks),
            **_LIMITS,
            "fps": RATE,
            "splits": {"train": f"0:{len(self._about)}"},
            "data_path": layout.DATA,
            "video_path": layout.VIDEO if len(pixels) else None,
            "features": {
                **({CAMERA_IMAGE: _video_feature()} if len(pixels) else {}),
                **{name: _feature(name, values) for name, values in columns.items()},
            },
        }
        (self._root / layout.INFO).write_text(json.dumps(information, indent=1))
        return information

    def _write(self, place: str, table) -> None:
        path = self._root / place
        path.parent.mkdir(parents=True, exist_ok=True)
        parquet()[1].write_table(table, path, compression="snappy")


def _statistics(columns: dict[str, np.ndarray], pixels: np.ndarray) -> dict[str, dict[str, list]]:
    summary = {name: summarize(values) for name, values in columns.items()}
    return {**summary, CAMERA_IMAGE: summarize_images(pixels)} if len(pixels) else summary


def _dtype(name: str) -> str:
    if name in _BOOKKEEPING:
        return "float32" if name == "timestamp" else "int64"
    return _DTYPES.get(name, "float32")


def _feature(name: str, values: np.ndarray) -> dict:
    names = list(NAMES[name]) if name in NAMES else None
    return {"dtype": _dtype(name), "shape": [values.shape[1]], "names": names}


def _video_feature() -> dict:
    information = {
        "video.height": _SHAPE[0],
        "video.width": _SHAPE[1],
        "video.channels": _SHAPE[2],
        "video.codec": "vp9",
        "video.pix_fmt": "yuv420p",
        "video.fps": RATE,
        "video.is_depth_map": False,
        "has_audio": False,
    }
    return {"dtype": "video", "shape": list(_SHAPE), "names": ["height", "width", "channels"], "info": information}


def _column(name: str, values: np.ndarray):
    """Values (n, numbers) as a column: lists of that many numbers, or the numbers themselves where it is one."""
    arrow, _ = parquet()
    flat = arrow.array(values.astype(_dtype(name)).ravel())
    return flat if values.shape[1] == 1 else arrow.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _task_table(tasks: Sequence[str]):
    """Task numbers under an index of task texts, as pandas writes a table: LeRobot reads it by pandas."""
    arrow, _ = parquet()
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    described = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
        for name, (kind, numpy) in kinds.items()
    ]
    pandas = {"index_columns": ["task"], "column_indexes": [], "columns": described, "pandas_version": "2.0"}
    table = arrow.table({"task_index": list(range(len(tasks))), "task": list(tasks)})
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})
