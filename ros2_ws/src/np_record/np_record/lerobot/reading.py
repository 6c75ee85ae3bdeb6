"""A LeRobot data set of format v3.0 as arrays: one of our own, or somebody else's."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from np_record.lerobot import layout
from np_record.lerobot.checking import check_tables
from np_record.lerobot.layout import Clip, DataSetEpisode, DataSetError, parquet
from np_record.lerobot.pictures import read_pictures


@dataclass(frozen=True, eq=False)
class DataSet:
    """A data set in memory, but for its pictures."""

    information: dict
    """meta/info.json."""
    tasks: tuple[str, ...]
    """By task_index."""
    episodes: tuple[DataSetEpisode, ...]
    """By episode_index."""
    columns: Mapping[str, np.ndarray]
    """By feature, (frames, *shape of the feature), in the order of `index`."""
    statistics: Mapping[str, Mapping[str, np.ndarray]]
    """By feature and name, empty where the set has none."""

    @property
    def rate(self) -> float:
        """Frames a second."""
        return float(self.information["fps"])

    def names(self, feature: str) -> list[str] | None:
        """Names of the numbers of a feature, None where the set has none."""
        names = self.information["features"][feature].get("names")
        return [name for part in names.values() for name in part] if isinstance(names, dict) else names

    def images(self, feature: str, episode: int) -> Iterator[np.ndarray]:
        """The pictures (height, width, 3) uint8 RGB of an episode: for each of its rows that of its timestamp.

        Raises DataSetError for a feature that is no video, and for a video that OpenCV cannot decode (as AV1). Also for a row
        without a picture of its time.
        """
        about = self.episodes[episode]
        if feature not in about.clips:
            known = ", ".join(about.clips) or "no videos"
            raise DataSetError(f"feature {feature}: expected a video of the data set, which has {known}")
        clip = about.clips[feature]
        return read_pictures(clip.path, clip.begin + self.columns["timestamp"][about.rows].ravel(), 0.5 / self.rate)


def read_data_set(root: str | Path) -> DataSet:
    """The data set in the folder `root`. Raises DataSetError for another format, or for one that contradicts itself."""
    root = Path(root)
    try:
        information = json.loads((root / layout.INFO).read_text())
        version = information.get("codebase_version")
        if version != layout.VERSION:
            raise DataSetError(f"data set {root}: expected format {layout.VERSION}, got {version}")
        statistics = root / layout.STATS
        summary = json.loads(statistics.read_text()) if statistics.exists() else {}
        tasks, about = _tasks(root), _about(root)
        episodes = tuple(_episode(root, information, row) for row in about)
        columns = _columns(root, information, about)
    except (OSError, KeyError, TypeError, json.JSONDecodeError, parquet()[0].ArrowException) as error:
        raise DataSetError(
            f"data set {root}: expected a LeRobot data set, got {type(error).__name__}: {error}"
        ) from error
    try:
        check_tables(information, tasks, episodes, columns)
    except DataSetError as error:
        raise DataSetError(f"data set {root}: {error}") from error
    arrays = {name: {key: np.asarray(value) for key, value in part.items()} for name, part in summary.items()}
    return DataSet(information, tasks, episodes, columns, arrays)


def _tasks(root: Path) -> tuple[str, ...]:
    """The sentences in the order of their number: the column that is not the number, whatever pandas called it."""
    rows = parquet()[1].read_table(root / layout.TASKS).to_pylist()
    ordered = sorted(rows, key=lambda row: row["task_index"])
    return tuple(next(value for key, value in row.items() if key != "task_index") for row in ordered)


def _about(root: Path) -> list[dict]:
    """The rows of meta/episodes in order, without statistics."""
    rows = []
    for path in sorted((root / "meta/episodes").glob("*/*.parquet")):
        file = parquet()[1].ParquetFile(path)
        rows += file.read([name for name in file.schema_arrow.names if not name.startswith("stats/")]).to_pylist()
    return sorted(rows, key=lambda row: row["episode_index"])


def _episode(root: Path, information: dict, row: dict) -> DataSetEpisode:
    if row["dataset_to_index"] - row["dataset_from_index"] != row["length"]:
        raise DataSetError(
            f"data set {root}: episode {row['episode_index']}: expected {row['length']} rows, got rows "
            f"{row['dataset_from_index']} to {row['dataset_to_index']}"
        )
    videos = [name for name, feature in information["features"].items() if feature["dtype"] == "video"]
    clips = {}
    for name in videos:
        place = {key: row[f"videos/{name}/{key}"] for key in layout.FIRST}
        path = root / information["video_path"].format(video_key=name, **place)
        clips[name] = Clip(path, *(float(row[f"videos/{name}/{end}_timestamp"]) for end in ("from", "to")))
    return DataSetEpisode(tuple(row["tasks"]), int(row["dataset_from_index"]), int(row["dataset_to_index"]), clips)


def _columns(root: Path, information: dict, about: list[dict]) -> dict[str, np.ndarray]:
    """Every feature but the pictures, of the files that the episodes are in."""
    features = {
        name: feature for name, feature in information["features"].items() if feature["dtype"] not in ("video", "image")
    }
    places = sorted({(row["data/chunk_index"], row["data/file_index"]) for row in about})
    parts: dict[str, list[np.ndarray]] = {name: [] for name in features}
    for chunk, file in places:
        path = root / information["data_path"].format(chunk_index=chunk, file_index=file)
        table = parquet()[1].read_table(path, columns=list(features))
        for name, feature in features.items():
            parts[name].append(_array(path, name, table[name], tuple(feature["shape"])))
    return {name: np.concatenate(part) for name, part in parts.items()}


def _array(path: Path, name: str, column, shape: tuple[int, ...]) -> np.ndarray:
    """A column as (n, *shape)."""
    arrow, _ = parquet()
    values, count = column.combine_chunks(), len(column)
    while isinstance(values, arrow.ExtensionArray):
        values = values.storage
    while arrow.types.is_list(values.type) or arrow.types.is_fixed_size_list(values.type):
        values = values.flatten()
    flat = values.to_numpy(zero_copy_only=False)
    if flat.size != count * int(np.prod(shape)):
        raise DataSetError(f"{path}: {name}: expected {count} rows of shape {shape}, got {flat.size} numbers")
    return flat.reshape(count, *shape)
