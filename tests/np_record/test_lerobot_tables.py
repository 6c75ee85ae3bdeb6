"""Tables of a LeRobot data set that contradict each other are refused; pictures are found by their time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from np_record.lerobot.checking import check_tables
from np_record.lerobot.layout import Clip, DataSetEpisode, DataSetError
from np_record.lerobot.pictures import read_pictures
from np_record.report.video import encode

RATE, LENGTHS = 10, (4, 3)


def tables():
    """(information, tasks, episodes, columns) of two episodes."""
    ends = np.cumsum(LENGTHS)
    episodes = [
        DataSetEpisode(("push",), end - n, end, {"camera": Clip(Path("v"), (end - n) / RATE, end / RATE)})
        for n, end in zip(LENGTHS, ends)
    ]
    steps = np.concatenate([np.arange(n) for n in LENGTHS])
    columns = {
        "index": np.arange(ends[-1]),
        "episode_index": np.repeat(np.arange(2), LENGTHS),
        "frame_index": steps,
        "timestamp": (steps / RATE).astype(np.float32),
        "task_index": np.zeros(ends[-1], int),
    }
    return (
        {"fps": RATE, "total_frames": int(ends[-1]), "total_episodes": 2, "total_tasks": 1},
        ["push"],
        episodes,
        columns,
    )


def stale(information, tasks, episodes, columns):
    episodes[1] = replace(episodes[1], begin=0, end=3)


def overlapping(information, tasks, episodes, columns):
    episodes[0] = replace(episodes[0], end=5)


def other_rows(information, tasks, episodes, columns):
    columns["episode_index"][4] = 0


def short(information, tasks, episodes, columns):
    episodes.pop()


def late(information, tasks, episodes, columns):
    columns["timestamp"][5] += 0.3


def other_task(information, tasks, episodes, columns):
    tasks.append("lift")
    information["total_tasks"] = 2
    columns["task_index"][6] = 1


def other_clip(information, tasks, episodes, columns):
    episodes[1] = replace(episodes[1], clips={"camera": Clip(Path("v"), 0.4, 0.9)})


def test_tables_that_agree_are_taken():
    check_tables(*tables())


@pytest.mark.parametrize(
    "spoil, text",
    [
        (stale, "episode 1: expected rows from 4 on, meta/episodes has 0 to 3"),
        (overlapping, "episode 0: rows 0 to 5 of meta/episodes carry episode_index 0, 1"),
        (other_rows, "episode 1: .* carry episode_index 0, 1"),
        (short, "expected 2 episodes, got 1"),
        (late, "episode 1: expected timestamps at 10 Hz from 0, one is 0.300 s off"),
        (other_task, "episode 1: its rows are of the task 'lift'"),
        (other_clip, "episode 1: camera: expected 0.3 s of video for 3 rows"),
    ],
)
def test_tables_that_contradict_each_other_are_refused(spoil, text):
    content = tables()
    spoil(*content)
    with pytest.raises(DataSetError, match=text):
        check_tables(*content)


def test_pictures_are_those_of_their_time(tmp_path):
    path = tmp_path / "video.mp4"
    encode(path, (np.full((64, 64, 3), 4 * n, np.uint8) for n in range(60)), 30, "vp09")  # thrice the rate of the rows
    found = [picture.mean() for picture in read_pictures(path, np.array([0.5, 0.6, 1.9]), 0.5 / 30)]
    np.testing.assert_allclose(found, [4 * 15, 4 * 18, 4 * 57], atol=3)
    with pytest.raises(DataSetError, match="expected a picture of 2.100 s, its last is of 1.967 s"):
        list(read_pictures(path, np.array([1.9, 2.1]), 0.05))
    with pytest.raises(DataSetError, match="no such file"):
        list(read_pictures(tmp_path / "none.mp4", np.zeros(1), 0.05))
