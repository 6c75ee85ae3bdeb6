"""The RealSense camera up to the SDK, on the SDK's software device; skipped where the hardware extra is not
installed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

# It is there without its library of USB devices, which is the system's, and cannot be imported then.
rs = pytest.importorskip(
    "pyrealsense2",
    reason="the SDK of the cameras is in the hardware extra (make hardware), and needs libusb-1.0",
    exc_type=ImportError,
)
sys.path.insert(0, str(Path(__file__).parent))

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image  # noqa: E402
from software_camera import SoftwareCamera, picture  # noqa: E402

from np_description.camera import CAMERA  # noqa: E402
from np_description.message_arrays import (  # noqa: E402
    camera_info_lens,
    image_array,
    stamp_nanoseconds,  # noqa: E402
)
from np_franka.realsense import RealSense, RealSenseSettings, find_device, lens_of  # noqa: E402
from np_perception.camera.rectify import Rectifier, project_distorted  # noqa: E402
from np_perception.camera.source import CameraError  # noqa: E402
from np_ros import qos  # noqa: E402


@pytest.fixture
def opened():
    """A software camera and the source that reads it."""
    camera = SoftwareCamera()
    source = RealSense(camera.device)
    yield camera, source
    source.close()


def read(source, tries=50):
    """The next frame that is used."""
    return next(frame for _ in range(tries) if (frame := source.read(0.2)) is not None)


def settle(camera, source, milliseconds=1000.0):
    """Send the frames that are not used."""
    for i in range(10):
        camera.push(milliseconds + 33.0 * i)
        assert source.read(1.0) is None


def test_nothing_is_automatic(opened):
    camera, _ = opened
    option = rs.option
    assert [
        camera.sensor.get_option(o)
        for o in (
            option.enable_auto_exposure,
            option.enable_auto_white_balance,
            option.global_time_enabled,
            option.exposure,
            option.gain,
            option.white_balance,
        )
    ] == [0, 0, 0, 80, 64, 4600]


def test_frames_come_with_their_pixels_and_on_the_hosts_clock(opened):
    camera, source = opened
    settle(camera, source)
    before = time.time_ns()
    camera.push(1330.0)
    frame = read(source)
    np.testing.assert_array_equal(frame.pixels, picture())
    assert abs(frame.stamp - before) < 10**9
    camera.push(1363.0, lost=2)
    later = read(source)
    # The camera's own distance between frames, but for what a less late arrival moved the mapping back.
    assert 0 < later.stamp - frame.stamp <= 33_000_000
    assert source.values["frames missed"] == 2 and source.values["clock"] == "hardware"


def test_the_middle_of_the_exposure_is_the_time_of_a_frame():
    stamps = []
    for exposed in (0, 12_000):
        camera = SoftwareCamera()
        source = RealSense(camera.device)
        for i in range(11):
            camera.push(1000.0 + 33.0 * i, exposed_us=exposed, domain=rs.timestamp_domain.system_time)
            frame = source.read(1.0)
        stamps.append(frame.stamp)
        source.close()
    assert stamps == [1_330_000_000, 1_318_000_000]


def test_without_hardware_time_the_stamps_of_arrival_are_used_and_said_to_be(opened):
    camera, source = opened
    now = time.time()
    for i in range(11):
        camera.push(1e3 * now + 0.01 * i, domain=rs.timestamp_domain.system_time)
        frame = source.read(1.0)
    assert frame.stamp == pytest.approx(round(1e9 * now) + 100_000, abs=2_000)
    assert "no hardware time" in source.values["clock"]


def test_nothing_comes_of_a_silent_camera(opened):
    assert opened[1].read(0.05) is None


def test_the_lens_projects_as_the_sdk_deprojects(opened):
    """A pixel that the SDK turns into a ray comes out of our lens as that pixel."""
    camera, source = opened
    intrinsics = camera.sensor.get_stream_profiles()[0].as_video_stream_profile().get_intrinsics()
    for pixel in ([641.0, 357.0], [400.0, 120.0], [900.0, 600.0]):
        ray = np.array(rs.rs2_deproject_pixel_to_point(intrinsics, pixel, 1.0))
        np.testing.assert_allclose(project_distorted(ray, source.lens), pixel, atol=1e-3)


@pytest.mark.parametrize(
    "arguments, words",
    [
        (dict(leave_out=(rs.option.exposure,)), "expected a colour sensor with the option"),
        (dict(stubborn=(rs.option.exposure,)), "camera: "),
        (
            dict(size=(640, 480)),
            "expected an rgb8 colour stream of 1280 x 720 at 30 Hz, it offers 640 x 480 at 30",
        ),
        (dict(model=rs.distortion.ftheta), "expected .inverse. Brown-Conrady"),
    ],
)
def test_a_camera_that_cannot_do_it_is_named(arguments, words):
    camera = SoftwareCamera(**arguments)
    with pytest.raises(CameraError, match=words):
        RealSense(camera.device)


def test_no_camera_and_no_sdk_are_named(monkeypatch):
    with pytest.raises(CameraError, match="expected a RealSense and only one, found none"):
        find_device()
    with pytest.raises(CameraError, match="serial number 4711, found none"):
        find_device("4711")
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(CameraError, match="make hardware"):
        find_device()


def test_brown_conrady_and_no_distortion_are_taken_as_they_are():
    for model, coefficients, expected in (
        (rs.distortion.none, [1, 1, 1, 1, 1], (0,) * 5),
        (rs.distortion.brown_conrady, [0.1, 0.2, 0.0, 0.0, 0.0], (0.1, 0.2, 0.0, 0.0, 0.0)),
    ):
        intrinsics = rs.intrinsics()
        intrinsics.width, intrinsics.height, intrinsics.fx, intrinsics.fy = 1280, 720, 900.0, 900.0
        intrinsics.model, intrinsics.coeffs = model, coefficients
        assert lens_of(intrinsics, rs).distortion == pytest.approx(expected)


def test_the_node_publishes_the_policies_view_and_tells_of_an_unplugged_camera(graph, probe):
    images, infos = probe.collect("camera/image_raw", Image), probe.collect("camera/camera_info", CameraInfo)
    diagnostics = probe.collect("diagnostics", DiagnosticArray, qos.EVENT)
    environment = {**os.environ, **graph.environment}
    child = subprocess.Popen(
        [
            sys.executable,
            str(Path(__file__).with_name("software_camera.py")),
            "--ros-args",
            "-p",
            "serial_number:='0815'",
        ],
        env=environment,
    )

    def says(level, text):
        return any(
            s.name == "/realsense_camera" and s.level == level and text in s.message
            for a in diagnostics
            for s in a.status
        )

    try:
        probe.wait_until(lambda: len(images) > 20 and infos, what="images")
        camera = SoftwareCamera()
        source = RealSense(camera.device, RealSenseSettings())
        view = Rectifier(source.lens)(picture())
        source.close()
        np.testing.assert_array_equal(image_array(images[-1]), view)
        lens, turn = camera_info_lens(infos[-1])
        assert (lens.width, lens.fx, lens.cx) == (CAMERA.width, CAMERA.fx, CAMERA.cx)
        np.testing.assert_array_equal(turn, np.eye(3))
        stamps = [stamp_nanoseconds(m.header.stamp) for m in images]
        assert (np.diff(stamps) > 0).all()
        child.send_signal(signal.SIGUSR1)
        probe.wait_until(lambda: says(DiagnosticStatus.ERROR, "no image for more than"), what="silence")
        probe.wait_until(lambda: says(DiagnosticStatus.ERROR, "expected a RealSense"), what="the search for it")
        diagnostics.clear(), images.clear()
        child.send_signal(signal.SIGUSR2)
        probe.wait_until(lambda: says(DiagnosticStatus.OK, "running") and len(images) > 5, what="images again")
        assert stamp_nanoseconds(images[0].header.stamp) > stamps[-1]
        child.send_signal(signal.SIGINT)
        assert child.wait(timeout=60) == 0
    finally:
        if child.poll() is None:
            child.kill()
            child.wait()
