"""Recordings as a LeRobot data set: what lies where, by pyarrow alone; read back; and loaded by LeRobot itself."""

import json
import os
import shutil
import subprocess

import numpy as np
import pytest
from bags import GOAL, brightness, joints, object_pose, record_episode

from np_description.phases import PhaseState
from np_policy import action
from np_record.bag import BagError, Recording
from np_record.lerobot import layout
from np_record.lerobot.frames import NAMES, RATE, read_episode_frames

pa = pytest.importorskip("pyarrow", reason="make lerobot")
pq = pytest.importorskip("pyarrow.parquet")

from np_record.commands import export_lerobot  # noqa: E402
from np_record.lerobot.reading import read_data_set  # noqa: E402
from np_record.lerobot.writing import write_data_set  # noqa: E402

LENGTHS = (29, 6)
BRIGHTNESS = [brightness(image) for length in LENGTHS for image in range(length)]
FAILS = {0: PhaseState("pre"), 50: PhaseState("approach"), 300: PhaseState("failed", "approach: no path")}
BOOKKEEPING = ("timestamp", "frame_index", "episode_index", "index", "task_index")
LOADER = os.environ.get("NP_LEROBOT_PYTHON", "")
"""The Python of an environment that has lerobot; this one may have no such thing."""


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags")
    return [record_episode(folder / "good"), record_episode(folder / "bad", count=650, phases=FAILS)]


@pytest.fixture(scope="module")
def root(bags, tmp_path_factory):
    path = tmp_path_factory.mktemp("set") / "episodes"
    write_data_set(path, bags)
    return path


def test_files_are_where_the_format_has_them(root):
    found = {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()}
    assert found == {
        "meta/info.json",
        "meta/stats.json",
        "meta/tasks.parquet",
        "meta/episodes/chunk-000/file-000.parquet",
        "data/chunk-000/file-000.parquet",
        f"videos/{layout.CAMERA_IMAGE}/chunk-000/file-000.mp4",
    }
    about = json.loads((root / layout.INFO).read_text())
    assert (about["codebase_version"], about["fps"], about["total_episodes"]) == ("v3.0", RATE, 2)
    assert about["total_frames"] == sum(LENGTHS) and about["splits"] == {"train": "0:2"}


def test_the_table_says_what_the_features_promise(root):
    features = json.loads((root / layout.INFO).read_text())["features"]
    table = pq.read_table(root / layout.DATA.format(**layout.FIRST))
    assert {*table.column_names} == features.keys() - {layout.CAMERA_IMAGE}
    for name in table.column_names:
        rows = np.array(table[name].to_pylist())
        assert rows.reshape(len(rows), -1).shape == (sum(LENGTHS), *features[name]["shape"]), name
        assert features[name]["names"] is None or len(features[name]["names"]) == features[name]["shape"][0]
    assert table["timestamp"].to_pylist()[:3] == pytest.approx([0, 0.1, 0.2])
    assert table["index"].to_pylist() == [*range(sum(LENGTHS))]
    assert table["episode_index"].to_pylist() == [0] * LENGTHS[0] + [1] * LENGTHS[1]


def test_episodes_say_which_rows_and_seconds_are_theirs(root):
    rows = pq.read_table(root / layout.EPISODES.format(**layout.FIRST)).to_pylist()
    assert [row["length"] for row in rows] == [*LENGTHS]
    assert [(row["dataset_from_index"], row["dataset_to_index"]) for row in rows] == [(0, 29), (29, 35)]
    key = f"videos/{layout.CAMERA_IMAGE}"
    assert [row[f"{key}/from_timestamp"] for row in rows] == pytest.approx([0, 2.9])
    assert [row["bag"] for row in rows] == ["good", "bad"]
    assert rows[1]["stats/index/mean"] == [31.5] and rows[1][f"stats/{layout.CAMERA_IMAGE}/count"] == [6]


def test_statistics_are_those_of_the_table(root):
    summary = json.loads((root / layout.STATS).read_text())
    read = read_data_set(root)
    state = read.columns[layout.STATE].astype(float)
    assert summary[layout.STATE]["mean"] == pytest.approx(state.mean(0), abs=1e-6)
    assert summary[layout.STATE]["q90"] == pytest.approx(np.quantile(state, 0.9, axis=0), abs=1e-6)
    assert np.shape(summary[layout.CAMERA_IMAGE]["mean"]) == (3, 1, 1)
    assert summary[layout.CAMERA_IMAGE]["mean"][0][0][0] == pytest.approx(np.mean(BRIGHTNESS) / 255)


def test_what_was_recorded_is_read_back(root):
    read = read_data_set(root)
    first, second = read.episodes
    assert first.tasks == read.tasks and "card" in read.tasks[0]
    state = read.columns[layout.STATE]
    position, _, effort, _ = joints(np.arange(29) / RATE)
    assert state[first.rows, :9] == pytest.approx(position, abs=1e-6)
    assert state[first.rows, 18:] == pytest.approx(effort, abs=1e-6)
    place = np.array([object_pose(50 * k, 1500).position for k in range(29)])
    assert read.columns[layout.OBJECT][first.rows, :3] == pytest.approx(place, abs=1e-6)
    assert read.columns[layout.GOAL][3, :3] == pytest.approx(GOAL.position, abs=1e-6)
    assert read.columns[layout.ACTION][0] == pytest.approx(
        joints(49 * 0.002)[3], abs=1e-6
    )  # the last before the next image
    assert read.columns[layout.PHASE][[0, 1, 28], 0].tolist() == [0, 1, 2]
    assert np.flatnonzero(read.columns[layout.DONE]).tolist() == [28, 34]
    assert np.flatnonzero(read.columns[layout.SUCCESS]).tolist() == [28]
    assert read.names(layout.KEYPOINTS) == list(NAMES[layout.KEYPOINTS]) and read.rate == RATE
    pictures = [picture for number in range(2) for picture in read.images(layout.CAMERA_IMAGE, number)]
    assert np.mean(pictures, axis=(1, 2, 3)) == pytest.approx(BRIGHTNESS, abs=6)


def test_every_number_of_every_frame_is_read_back(bags, root):
    read = read_data_set(root)
    for bag, episode in zip(bags, read.episodes):
        with Recording(bag) as recording:
            frames = read_episode_frames(recording)
        assert set(read.columns) == {*frames.columns, *BOOKKEEPING} and episode.tasks == (frames.task,)
        for name, values in frames.columns.items():
            was = values.astype(read.information["features"][name]["dtype"])
            assert np.array_equal(read.columns[name][episode.rows], was), name
        time = read.columns["timestamp"][episode.rows, 0]
        assert np.array_equal(time, (np.arange(len(frames)) / RATE).astype(np.float32))
    for name, summary in json.loads((root / layout.STATS).read_text()).items():
        assert all(np.array_equal(read.statistics[name][key], np.asarray(value)) for key, value in summary.items())


def test_a_data_set_in_several_files_is_read_as_one(root, tmp_path):
    """As others write them: a table and a page of episodes each, and not in the order of their names."""
    parts = tmp_path / "parts"
    shutil.copytree(root, parts)
    table, about = (pq.read_table(parts / place.format(**layout.FIRST)) for place in (layout.DATA, layout.EPISODES))
    rows = about.to_pylist()
    for number, row in enumerate(rows):
        place = {"chunk_index": number, "file_index": 1 - number}
        data, page = (parts / path.format(**place) for path in (layout.DATA, layout.EPISODES))
        for path in (data, page):
            path.parent.mkdir(parents=True, exist_ok=True)
        own = {"data/chunk_index": place["chunk_index"], "data/file_index": place["file_index"]}
        pq.write_table(table.slice(row["dataset_from_index"], row["length"]), data)
        pq.write_table(pa.Table.from_pylist([row | own]), page)
    for place in (layout.DATA, layout.EPISODES):
        (parts / place.format(**layout.FIRST)).unlink()
    whole, read = read_data_set(root), read_data_set(parts)
    assert read.episodes[1].rows == slice(29, 35)
    assert all(np.array_equal(read.columns[name], values) for name, values in whole.columns.items())
    pictures = [np.mean(picture) for picture in read.images(layout.CAMERA_IMAGE, 1)]
    assert pictures == pytest.approx(BRIGHTNESS[29:], abs=6)


def test_a_frame_is_the_policies_tick():
    assert RATE == action.RATE


def test_an_arm_without_truth_has_no_object_pose(tmp_path):
    bag = record_episode(tmp_path / "bag", count=300, leave_out=("object_pose", "camera/image_raw"))
    assert export_lerobot.main([str(bag), "--out", str(tmp_path / "set")]) == 0
    read = read_data_set(tmp_path / "set")
    assert layout.OBJECT not in read.columns and not (tmp_path / "set/videos").exists()
    assert not read.columns[layout.SUCCESS].any()  # never said to have ended
    with pytest.raises(layout.DataSetError, match="has no videos"):
        next(read.images(layout.CAMERA_IMAGE, 0))


def test_bags_that_do_not_fit_together_are_refused(bags, tmp_path, capsys):
    blind = record_episode(tmp_path / "blind", count=300, leave_out=("camera/image_raw",))
    assert export_lerobot.main([str(bags[0]), str(blind), "--out", str(tmp_path / "set")]) == 1
    assert "differ in observation.images.camera" in capsys.readouterr().err
    assert not (tmp_path / "set").exists()  # for the next call


def test_a_bag_without_an_episode_and_a_folder_that_exists_are_refused(bags, tmp_path, capsys):
    idle = record_episode(tmp_path / "idle", count=200, phases={0: PhaseState("idle")})
    with pytest.raises(BagError, match="phase pre was never published"):
        write_data_set(tmp_path / "set", [idle])
    assert export_lerobot.main([str(bags[0]), "--out", str(tmp_path)]) == 1
    assert "expected a new folder, it exists" in capsys.readouterr().err


def test_another_format_is_named(root, tmp_path):
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta/info.json").write_text(json.dumps({"codebase_version": "v2.1"}))
    with pytest.raises(layout.DataSetError, match="expected format v3.0, got v2.1"):
        read_data_set(tmp_path)
    with pytest.raises(layout.DataSetError, match="expected a LeRobot data set, got FileNotFoundError"):
        read_data_set(tmp_path / "nothing")


LOAD = """
import json, sys
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
data = LeRobotDataset("local/episodes", root=sys.argv[1], video_backend="pyav")
rows = [data[i] for i in range(len(data))]
one = rows[30]
print(json.dumps({
    "length": len(data), "episodes": data.num_episodes, "fps": data.fps,
    "state": [row["observation.state"].tolist() for row in rows],
    "success": [bool(row["next.success"]) for row in rows],
    "task": one["task"],
    "image": list(one["observation.images.camera"].shape),
    "brightness": [float(row["observation.images.camera"].mean()) for row in rows],
    "mean": np.ravel(data.meta.stats["observation.state"]["mean"]).tolist(),
}))
"""


@pytest.mark.slow
@pytest.mark.skipif(not LOADER, reason="NP_LEROBOT_PYTHON: expected the Python of an environment with lerobot")
def test_lerobots_own_loader_reads_it(root):
    clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "LD_LIBRARY_PATH")}
    said = subprocess.run(
        [LOADER, "-c", LOAD, str(root)], capture_output=True, text=True, env={**clean, "HF_HUB_OFFLINE": "1"}
    )
    assert said.returncode == 0, said.stderr
    loaded, read = json.loads(said.stdout.splitlines()[-1]), read_data_set(root)
    assert (loaded["length"], loaded["episodes"], loaded["fps"]) == (sum(LENGTHS), 2, RATE)
    assert np.array(loaded["state"]) == pytest.approx(read.columns[layout.STATE])
    assert loaded["success"] == read.columns[layout.SUCCESS][:, 0].tolist()
    assert loaded["task"] == read.tasks[0] and loaded["image"] == [3, 224, 224]
    assert loaded["brightness"] == pytest.approx(np.array(BRIGHTNESS) / 255, abs=0.025)
    assert loaded["mean"] == pytest.approx(read.statistics[layout.STATE]["mean"])
