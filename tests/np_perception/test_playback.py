"""Images from bags and folders: what is played is what was recorded, and what cannot be played is named."""

import cv2
import numpy as np
import pytest
import yaml
from bags import brightness, record_episode

from np_description.calibration import Lens
from np_perception.camera.playback import POLICY_LENS, Playback
from np_perception.camera.source import CameraError, EndOfImages


def write_pictures(folder, names, size=(224, 224), suffix=".png"):
    folder.mkdir(exist_ok=True)
    images = []
    for i, name in enumerate(names):
        image = np.random.default_rng(i).integers(0, 256, (*size, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / f"{name}{suffix}"), image[..., ::-1])
        images.append(image)
    return images


def play(playback):
    frames = []
    while True:
        try:
            frame = playback.read(1.0)
        except EndOfImages:
            return frames
        if frame is not None:
            frames.append(frame)


def test_a_folder_is_played_in_the_order_of_its_stamps(tmp_path):
    images = write_pictures(tmp_path / "p", ["9", "10000009", "200000009"])
    frames = play(Playback(tmp_path / "p", rate=100.0, stamps="recorded"))
    assert [frame.stamp for frame in frames] == [9, 10_000_009, 200_000_009]
    for frame, image in zip(frames, images, strict=True):
        np.testing.assert_array_equal(frame.pixels, image)


def test_stamps_of_now_keep_the_recorded_distances(tmp_path):
    write_pictures(tmp_path / "p", ["a", "b", "c"])
    (tmp_path / "p" / "camera.yaml").write_text(
        yaml.safe_dump({"fx": 300.0, "fy": 300.0, "cx": 111.5, "cy": 111.5, "rate": 5})
    )
    playback = Playback(tmp_path / "p", rate=100.0)
    assert playback.lens == Lens(224, 224, 300.0, 300.0, 111.5, 111.5) and playback.period == pytest.approx(0.002)
    stamps = np.array([frame.stamp for frame in play(playback)])
    np.testing.assert_array_equal(np.diff(stamps), 2_000_000)


def test_a_bag_is_played(tmp_path):
    bag = record_episode(tmp_path / "bag", count=200)
    playback = Playback(bag, rate=100.0, stamps="recorded")
    assert playback.lens == POLICY_LENS
    frames = play(playback)
    assert [frame.stamp for frame in frames] == [0, 10**8, 2 * 10**8, 3 * 10**8]
    assert all((frame.pixels == brightness(image)).all() for image, frame in enumerate(frames))


def test_repeated_images_go_on(tmp_path):
    write_pictures(tmp_path / "p", ["a", "b"])
    playback = Playback(tmp_path / "p", rate=100.0, repeat=True)
    stamps = [frame.stamp for _ in range(7) if (frame := playback.read(1.0))]
    assert len(stamps) == 7 and (np.diff(stamps) > 0).all()


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda p: p / "nothing", "does not exist"),
        (lambda p: p, "expected PNG or JPEG pictures, found none"),
        (
            lambda p: (write_pictures(p, ["a"], (100, 120)), p)[1],
            "expected 224 x 224 pictures, or camera.yaml",
        ),
        (lambda p: (write_pictures(p, ["a", "12"]), p)[1], "names of all pictures or of none, got a.png"),
        (
            lambda p: (write_pictures(p, ["a"]), (p / "camera.yaml").write_text("fx: 3"), p)[2],
            "camera.yaml: expected fx",
        ),
        (
            lambda p: ((p / "a.png").write_bytes(b"no picture"), p)[1],
            "a.png: expected PNG or JPEG, it cannot be read",
        ),
        (
            lambda p: record_episode(p / "bag", count=10, leave_out=("camera/image_raw",)),
            "expected messages on camera/image_raw",
        ),
    ],
)
def test_what_cannot_be_played_is_named(tmp_path, make, words):
    with pytest.raises(CameraError, match=words):
        Playback(make(tmp_path))


def test_a_cut_off_bag_is_named(tmp_path):
    bag = record_episode(tmp_path / "bag", count=200)
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-2000])
    with pytest.raises(CameraError, match="cut off"):
        Playback(bag)


def test_recorded_stamps_are_not_repeated(tmp_path):
    with pytest.raises(CameraError, match="time cannot run backwards"):
        Playback(tmp_path, stamps="recorded", repeat=True)
