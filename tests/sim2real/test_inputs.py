"""Recordings, cameras and data sets of other people: each is read right, or refused by what it is. Skipped without their folder."""

import os
import tarfile
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from sim2real.arm.files import load_arm
from sim2real.cli import diagnose as command
from sim2real.recordings.reading import ContractViolation, load_log
from sim2real.recordings.speed_lag import correct_speed

from np_common.rotations import matrix_from_quaternion
from np_perception.calibration.board import Board
from np_perception.calibration.evidence import read_calibration_data
from np_perception.calibration.fitting import calibrate
from np_record.bag import BagError, Recording
from np_record.lerobot.frames import read_episode_frames
from np_record.recorded_episode import load_episode

INPUTS = Path(os.environ.get("NP_FOREIGN_INPUTS", Path(__file__).resolve().parents[3] / "shared" / "inputs"))
pytestmark = pytest.mark.skipif(
    not INPUTS.exists(), reason="NP_FOREIGN_INPUTS: expected the folder of foreign recordings"
)
FR3 = [f"fr3_joint{number}" for number in range(1, 8)]
ROWS = 9036


@pytest.fixture
def unpack(tmp_path):
    def unpacked(name: str) -> Path:
        with tarfile.open(INPUTS / f"{name}.tar.xz") as archive:
            archive.extractall(
                tmp_path, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {})
            )  # Python 3.11.4 and later
        return tmp_path / name

    return unpacked


def test_gains_logged_by_another_clock_are_refused(unpack):
    with pytest.raises(ContractViolation, match="target_gains: expected messages with a stamp.*joint_states is logged"):
        load_log(unpack("01_log_time_is_arrival") / "bag")


@pytest.mark.parametrize("name", ["02_message_zstd", "37_custom_data"])
def test_compressed_messages_and_other_metadata_are_read(unpack, name):
    assert len(load_log(unpack(name) / "bag").time) == ROWS


def test_metadata_of_another_form_is_named_where_it_is_needed(unpack):
    with pytest.raises(BagError, match="expected a JSON object as run_info .*'evening, arm 2'"):
        len(Recording(unpack("37_custom_data") / "bag").information)


@pytest.mark.parametrize("name", ["14_arm_and_gripper_publish_in_turn", "15_nan_effort_of_gripper"])
def test_a_gripper_leaves_the_arm_readable(unpack, name):
    log = load_log(unpack(name) / "bag", FR3)
    assert log.position.shape == (ROWS, 7) and np.isfinite(log.torque).all()


@pytest.mark.parametrize("reader", [load_episode, read_episode_frames])
def test_an_episode_logged_by_another_clock_is_refused(unpack, reader):
    bag = unpack("21_episode_arrival_times") / "bag"
    with pytest.raises(BagError, match="episode/phase: expected messages with a stamp"), Recording(bag) as recording:
        reader(recording)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["24_stereo_rectification_in_r", "41_images_arrive_late"])
def test_a_camera_is_found_where_it_is(unpack, name):
    folder = unpack(name)
    found = calibrate(read_calibration_data(folder / "bag", Board()), Board(), datetime.now(UTC)).calibration
    truth = np.load(folder / "truth.npz")
    rotation = truth["rotation"] if truth["rotation"].shape == (3, 3) else matrix_from_quaternion(truth["rotation"])
    angle = np.degrees(np.arccos(np.clip((np.trace(found.rotation.T @ rotation) - 1) / 2, -1, 1)))
    assert angle < 0.01 and np.linalg.norm(found.position - truth["position"]) < 1e-4


def test_stale_bounds_of_episodes_are_refused(unpack):
    pytest.importorskip("pyarrow", reason="make lerobot")
    from np_record.lerobot.reading import DataSetError, read_data_set

    with pytest.raises(DataSetError, match="episode 1: expected rows from 20 on, meta/episodes has 0 to 30"):
        read_data_set(unpack("26_lerobot_stale_episode_bounds") / "set")


def test_a_speed_that_lags_is_replaced(unpack):
    folder = unpack("30_filtered_speed")
    arm = load_arm(folder / "arm.xml", tip="tool")
    right, late = (load_log(folder / f"{name}.npz", arm) for name in ("right_speed", "run"))
    assert correct_speed(right, arm.joints) is right
    found = correct_speed(late, arm.joints)
    assert found.speed_lag == pytest.approx(0.017, abs=0.003)
    error, before = (np.abs(log.velocity - right.velocity).mean() for log in (found, late))
    assert error < 0.1 * before


def test_joints_that_move_and_are_not_named_are_refused(unpack):
    folder = unpack("43_unnamed_joints_move")
    with pytest.raises(ContractViolation, match="wrist_1 .*wrist_2 .*wrist_3 .* did not: name them"):
        load_log(folder / "bag", load_arm(folder / "arm.xml", ["waist", "shoulder", "elbow"]))
    assert len(load_log(folder / "bag", load_arm(folder / "arm.xml")).time) == 8000


@pytest.mark.slow
@pytest.mark.parametrize(
    "name, log, options",
    [
        ("22_real_ur5_currents", "run_with_constants.npz", ()),
        ("30_filtered_speed", "run.npz", ("--tip", "tool")),
        ("42_real_ur5_bag", "bag", ("--effort", "current")),
    ],
)
def test_a_page_of_another_arm_is_finished(unpack, tmp_path, name, log, options):
    folder = unpack(name)
    model = next(path for path in folder.iterdir() if path.suffix in (".urdf", ".xml"))
    assert command.main([str(folder / log), "--model", str(model), *options, "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "report.html").exists()
