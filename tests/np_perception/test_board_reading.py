"""What a calibration recording shows: boards of either layout, and images that were taken when the arm moved."""

from datetime import UTC, datetime

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from np_description.camera import Camera
from np_description.control_rate import SECOND
from np_description.panda import NOMINAL, STATE_NAMES
from np_perception.calibration.board import Board
from np_perception.calibration.evidence import CalibrationRefusal, read_calibration_data
from np_perception.calibration.fitting import calibrate
from np_perception.camera.rectify import view_camera
from np_record.bag_writer import BagWriter
from np_record.topics import BY_NAME
from np_ros.messages import camera_info_message, image_message, joint_state_message


def record(path, board: Board, taken: float):
    """A bag of an arm at rest for 2 s, and one picture of a board of `taken` s, logged late."""
    camera: Camera = view_camera("calibration")
    image = np.full((camera.height, camera.width, 3), 255, np.uint8)
    picture = board.picture(1200)[:400, :400]
    image[: picture.shape[0], : picture.shape[1]] = picture[..., None]
    writer = BagWriter(path, {})
    stamp = round(taken * SECOND)
    joints = [*NOMINAL.ready, 0.0, 0.0]
    messages = [
        ("joint_states", t, joint_state_message(t, STATE_NAMES, joints, np.zeros(9), np.zeros(9)))
        for t in range(0, 2 * SECOND, SECOND // 50)
    ]
    messages += [("camera/camera_info", stamp, camera_info_message(stamp, "camera", camera))]
    messages += [("camera/image_raw", stamp, image_message(stamp, "camera", image))]
    for name, logged, message in messages:
        late = SECOND if name.startswith("camera/") else 0
        writer.write(logged + late, BY_NAME[name], serialize_message(message))
    writer.close()
    return path


@pytest.mark.parametrize("is_legacy", [False, True])
def test_a_board_of_either_layout_is_found(tmp_path, is_legacy):
    """The layouts differ where the number of rows is even."""
    drawn = Board(columns=6, rows=6, is_legacy=is_legacy)
    found = read_calibration_data(record(tmp_path / "bag", drawn, 1.0), Board(columns=6, rows=6))
    assert found.is_legacy == is_legacy and found.images == 1
    assert len(found.detections[0][1].ids) == 25


def test_images_of_another_time_are_named_as_such(tmp_path):
    data = read_calibration_data(record(tmp_path / "bag", Board(), 2.5), Board())
    with pytest.raises(
        CalibrationRefusal, match="none of 1 was: by their stamps they are of 2.500 to 2.500 s, the 1 rests"
    ):
        calibrate(data, Board(), datetime.now(UTC))
