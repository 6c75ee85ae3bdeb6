"""The tables of a LeRobot data set compared with each other: each assigns rows, times and pictures to episodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from np_record.lerobot.layout import DataSetEpisode, DataSetError


def check_tables(
    information: Mapping, tasks: Sequence[str], episodes: Sequence[DataSetEpisode], columns: Mapping[str, np.ndarray]
) -> None:
    """Raise DataSetError where meta/info.json, meta/tasks, meta/episodes and the rows contradict each other."""
    rows, rate = len(columns["index"]), float(information["fps"])
    flat = {
        name: columns[name].ravel() for name in ("index", "episode_index", "frame_index", "timestamp", "task_index")
    }
    if not rate > 0:
        raise DataSetError(f"expected more than 0 frames a second, got {rate}")
    if rows != information["total_frames"] or not np.array_equal(flat["index"], np.arange(rows)):
        raise DataSetError(f"expected {information['total_frames']} frames in order, got {rows}")
    for what, count in (("episodes", len(episodes)), ("tasks", len(tasks))):
        if information.get(f"total_{what}", count) != count:
            raise DataSetError(f"expected {information[f'total_{what}']} {what}, got {count}")
    after = 0
    for number, episode in enumerate(episodes):
        if episode.begin != after or episode.end <= episode.begin:
            raise DataSetError(
                f"episode {number}: expected rows from {after} on, meta/episodes has {episode.begin} to {episode.end}"
            )
        after = episode.end
        _check_episode(number, episode, {name: column[episode.rows] for name, column in flat.items()}, tasks, rate)
    if after != rows:
        raise DataSetError(f"expected episodes of {rows} rows in all, meta/episodes ends at {after}")


def _check_episode(
    number: int, episode: DataSetEpisode, rows: Mapping[str, np.ndarray], tasks: Sequence[str], rate: float
) -> None:
    length = episode.end - episode.begin
    steps = np.arange(length)
    if len(rows["index"]) != length:
        raise DataSetError(f"episode {number}: expected {length} rows, the table has {len(rows['index'])} of them")
    for name, expected in (("episode_index", np.full(length, number)), ("frame_index", steps)):
        if not np.array_equal(rows[name], expected):
            found = ", ".join(map(str, np.unique(rows[name])[:5]))
            raise DataSetError(
                f"episode {number}: rows {episode.begin} to {episode.end} of meta/episodes carry {name} {found}"
            )
    late = np.abs(rows["timestamp"] - steps / rate).max()
    if not late < 0.5 / rate:
        raise DataSetError(f"episode {number}: expected timestamps at {rate:g} Hz from 0, one is {late:.3f} s off")
    if rows["task_index"].min() < 0 or rows["task_index"].max() >= len(tasks):
        raise DataSetError(
            f"episode {number}: expected task_index 0 .. {len(tasks) - 1}, got {rows['task_index'].max()}"
        )
    other = {tasks[int(index)] for index in np.unique(rows["task_index"])}.difference(episode.tasks)
    if other:
        raise DataSetError(
            f"episode {number}: its rows are of the task {sorted(other)[0]!r}, meta/episodes has {episode.tasks}"
        )
    for name, clip in episode.clips.items():
        if not abs(clip.end - clip.begin - length / rate) < 1 / rate:
            raise DataSetError(
                f"episode {number}: {name}: expected {length / rate:g} s of video for {length} rows, meta/episodes has "
                f"{clip.begin:g} to {clip.end:g} s"
            )
