"""What a person sees of an episode: the page's data, the page in a browser where there is one, markers and /tf."""

import json
import os
import re
import shutil
import subprocess
import sys
import types
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
import yaml
from bags import GOAL, joints, object_pose, record_episode
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TransformStamped
from graph_tools import ROOT, TIMEOUT, command
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from np_bringup.commands import view
from np_bringup.nodes import robot_state_node
from np_bringup.view import window
from np_bringup.view.live import LiveGraph
from np_bringup.view.recorded import RecordedEpisode
from np_bringup.view.server import PAGE, serve
from np_common.rotations import matrix_from_quaternion
from np_control.kinematics import forward_kinematics, hand_pose
from np_description.domains import BUMP, CARD, Pose
from np_description.drawing.expected_view import find_expected_outlines
from np_description.drawing.robot import urdf
from np_description.drawing.scene_data import SceneData
from np_description.panda import NOMINAL, STATE_NAMES
from np_record.bag import Recording
from np_record.nodes.recorder_node import find_message_class
from np_record.topics import BY_NAME
from np_ros import qos
from np_ros.goals import goal_text
from np_ros.messages import joint_state_message, pose_message

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), "")
CONFIG = ROOT / "ros2_ws/src/np_bringup/config"
READY = np.append(NOMINAL.ready, [0.01, 0.02])


def asked(address: str):
    """The JSON at an address."""
    return json.loads(urlopen(address, timeout=TIMEOUT).read())


def test_bodies_are_where_the_kinematics_have_them():
    data = SceneData(BUMP)
    poses = dict(zip(data.bodies, data.poses(READY, None, GOAL)))
    position, rotation = hand_pose(READY[:7])
    np.testing.assert_allclose(poses["panda_hand"][:3], position, atol=1e-4)
    np.testing.assert_allclose(matrix_from_quaternion(np.array(poses["panda_hand"][3:])), rotation, atol=5e-4)
    between = 0.5 * (np.array(poses["panda_finger1"][:3]) + poses["panda_finger2"][:3])
    assert 0.03 < np.linalg.norm(between - forward_kinematics(READY[:7])[0]) < 0.06  # from their frames to their tips
    assert poses["object"] is None and poses["goal"][:3] == pytest.approx(GOAL.position.tolist())
    assert [s for s in data.scene()["shapes"] if data.bodies[s["body"]] == "world" and s["kind"] == "box"]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The address of a recorded episode."""
    bag = record_episode(tmp_path_factory.mktemp("view") / "bag")
    with serve(RecordedEpisode(str(bag)), "127.0.0.1", 0) as server:
        yield server.address
        server.shutdown()


def test_a_recorded_episode_as_the_page_gets_it(page):
    scene, episode = asked(page + "scene.json"), asked(page + "episode.json")
    assert scene["domain"] == "card" and not scene["live"] and scene["has_images"]
    moments = episode["moments"]
    times = [moment["time"] for moment in moments]
    assert len(moments) == 60 and np.allclose(np.diff(times), 0.05, atol=0.003)
    assert [text for _, text in episode["phases"]] == ["pre", "approach", "post", "succeeded"]
    assert moments[-1]["distance"] < 0.002 < moments[30]["distance"]
    assert all(len(moment["poses"]) == len(scene["bodies"]) for moment in moments)
    assert urlopen(page + "image.jpg?time=1.0").read().startswith(b"\xff\xd8")
    for path, status in (("nothing.json", 404), ("state.json", 404), ("image.jpg?time=soon", 400)):
        with pytest.raises(HTTPError, match=str(status)):
            urlopen(page + path)


@pytest.mark.skipif(not BROWSER, reason="no chromium")
def test_the_page_draws_the_episode_in_a_browser(page):
    """What stands in the document once its script has run."""
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=8000", "--dump-dom"]
    succeeded = '<div id="phase">succeeded</div>'
    for _ in range(5):  # the browser's time runs on while a busy machine has not sent the episode yet
        done = subprocess.run(
            [BROWSER, *flags, page + "?time=2.9&expected"], capture_output=True, text=True, timeout=2 * TIMEOUT
        )
        if succeeded in done.stdout:
            break
    assert succeeded in done.stdout
    drawn = int(re.search(r'data-drawn="(\d+)"', done.stdout)[1])
    assert drawn > 15  # capsules, and the faces of object and goal that can be seen
    assert re.search(r'<div id="error">\d+\.\d mm, \d+\.\d degrees from the goal', done.stdout)
    assert re.search(r'<img id="camera"[^>]*src="http[^"]*image.jpg\?time=2.9"', done.stdout)
    assert '<div id="seen" class="large"' in done.stdout
    assert len(re.findall(r'<line x1="-?\d', done.stdout)) == len(find_expected_outlines(CARD))


def test_a_late_viewer_shows_the_goal_of_the_episode_not_the_one_that_is_latched(graph, probe):
    live = LiveGraph(probe, CARD)
    drawn, given = Pose(np.array([0.55, 0.1, 0.0025]), np.array([1.0, 0, 0, 0])), GOAL
    text = goal_text(pose_message(7, "panda_link0", given.position, given.quaternion))
    status = DiagnosticStatus(name="/episode", values=[KeyValue(key="goal", value=text)])
    messages = {
        "goal_pose": (pose_message(5, "panda_link0", drawn.position, drawn.quaternion), qos.LATCHED),
        "diagnostics": (DiagnosticArray(status=[status]), qos.EVENT),
        "joint_states": (joint_state_message(9, STATE_NAMES, READY, np.zeros(9), np.zeros(9)), qos.LOCKSTEP),
    }
    for topic, (message, profile) in messages.items():
        probe.advertise(topic, type(message), profile)
        probe.wait_until(lambda topic=topic: probe.matched(topic), what=topic)
        probe.publish(topic, message)
    probe.wait_until(lambda: live.moment() and live.moment().goal, what="a goal")
    probe.wait_until(
        lambda: np.allclose(live.moment().goal.position, given.position, atol=1e-4), what="the episode's goal"
    )


def test_a_port_in_use_is_named(page):
    port = int(page.split(":")[2].strip("/"))
    with pytest.raises(OSError, match=f"--port {port}, --host 127.0.0.1: expected a free address"):
        serve(None, "127.0.0.1", port)


def test_others_on_the_network_need_the_address_that_was_printed(tmp_path):
    bag = record_episode(tmp_path / "bag")
    with serve(RecordedEpisode(str(bag)), "0.0.0.0", 0) as server:
        root, secret = f"http://127.0.0.1:{server.server_port}", server.address.split("/")[3]
        assert len(secret) >= 20
        for path in ("/", "/scene.json", "/image.jpg?time=0", f"/{secret[:-1]}/", f"/{secret}"):
            with pytest.raises(HTTPError, match="403"):
                urlopen(root + path, timeout=TIMEOUT)
        assert urlopen(f"{root}/{secret}/", timeout=TIMEOUT).read() == PAGE.read_bytes()
        assert asked(f"{root}/{secret}/scene.json")["domain"] == "card"
        server.shutdown()


def test_the_page_needs_nothing_from_elsewhere():
    assert not re.search(r"(src|href)=\"|https?:|import ", PAGE.read_text())


def test_a_running_graph_and_what_rviz_gets_of_it(graph, probe):
    """With the smallest backend there is; the page's data, the robot's description, the markers."""
    graph.run("examples", "minimal_backend")
    graph.run("np_bringup", "robot_state")
    viewer = subprocess.Popen(
        [*command("np_bringup", "view"), "--port", "0"],
        env={**os.environ, **graph.environment, "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        address = viewer.stdout.readline().split()[0]
        probe.wait_until(lambda: asked(address + "state.json")["poses"], what="a joint state at the page")
        shown = probe.collect("scene_markers", MarkerArray)
        described = probe.collect("robot_description", String, qos.LATCHED)
        probe.wait_until(lambda: shown and described, what="markers and description")
        state = asked(address + "state.json")
    finally:
        viewer.terminate()
        assert viewer.wait(TIMEOUT) == 0
        viewer.stdout.close()
    bodies = SceneData(CARD).bodies
    hand = state["poses"][bodies.index("panda_hand")][:3]
    np.testing.assert_allclose(hand, hand_pose(NOMINAL.ready)[0], atol=2e-3)
    assert state["poses"][bodies.index("object")] is None and state["distance"] is None
    assert described[0].data == urdf()
    kinds = [marker.type for marker in shown[0].markers]
    assert kinds.count(Marker.SPHERE) == 2 * kinds.count(Marker.CYLINDER) > 0
    named = [bodies[shape["body"]] for shape in SceneData(CARD).scene()["shapes"] if shape["kind"] == "box"]
    assert kinds.count(Marker.CUBE) == sum(
        name not in ("object", "goal") for name in named
    )  # nobody knows where those are


def test_tf_is_published_where_its_type_is_installed(monkeypatch):
    assert robot_state_node.tf_message() is None or "tf2_msgs" in sys.modules
    fake = types.ModuleType("tf2_msgs.msg")
    fake.TFMessage = TransformStamped
    monkeypatch.setitem(sys.modules, "tf2_msgs", types.ModuleType("tf2_msgs"))
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", fake)
    assert robot_state_node.tf_message() is TransformStamped


def test_transforms_and_markers_are_those_of_the_scene():
    data = SceneData(CARD, meshes=False)
    pose = Pose(np.array([0.5, 0.1, 0.0025]), np.array([1.0, 0, 0, 0]))
    scene, poses = data.scene(), data.poses(READY, pose, GOAL)
    found = {t.child_frame_id: t for t in robot_state_node.transforms(scene, poses, 7)}
    assert {"panda_link1", "panda_hand", "object", "goal"} <= set(found) and "panda_link0" not in found
    to = found["panda_hand"].transform
    np.testing.assert_allclose(
        [to.translation.x, to.translation.y, to.translation.z], hand_pose(READY[:7])[0], atol=1e-4
    )
    boxes = [m for m in robot_state_node.markers(scene, poses, 7).markers if m.type == Marker.CUBE]
    named = [scene["bodies"][shape["body"]] for shape in scene["shapes"] if shape["kind"] == "box"]
    assert len(boxes) == len(named) and named.count("object") == 8 and named.count("goal") == 1
    blocks = [box.pose.position for box, name in zip(boxes, named) if name == "object"]
    middle = np.mean([[at.x, at.y, at.z] for at in blocks], axis=0)
    np.testing.assert_allclose(middle, pose.position, atol=1e-4)


def test_a_window_shows_the_moments_of_a_bag(tmp_path):
    """All but the drawing, which wants a display: joints, object and goal, twenty times a second."""
    bag, shown = record_episode(tmp_path / "bag", count=500), []

    class Recorded:
        def __init__(self, domain):
            assert domain is CARD

        is_open = property(lambda self: len(shown) < 25)
        show = staticmethod(shown.append)
        close = staticmethod(lambda: shown.append(None))

    with Recording(bag) as recording:
        window.play(recording, CARD, Recorded)
    *drawn, last = shown
    assert len(drawn) == 25 and last is None  # closed in the second round
    assert drawn[0].body is None and drawn[5].body.position == pytest.approx(object_pose(100, 500).position)
    assert drawn[5].goal.position == pytest.approx(GOAL.position)
    np.testing.assert_allclose(drawn[5].joints, joints(0.25)[0], atol=1e-9)


def test_without_a_display_there_is_one_clear_line(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    bag = record_episode(tmp_path / "bag", count=50)
    assert view.main([str(bag), "--window"]) == 1
    assert capsys.readouterr().err.startswith("view: --window: expected a display (DISPLAY or WAYLAND_DISPLAY)")


def test_layouts_name_displays_and_panels_that_there_are():
    """By the list of rviz_default_plugins (Jazzy) and Foxglove's documentation of panels; neither program is here."""
    rviz = yaml.safe_load((CONFIG / "episode.rviz").read_text())["Visualization Manager"]
    kinds = {f"rviz_default_plugins/{name}" for name in ("Grid", "MarkerArray", "RobotModel", "Pose", "Image")}
    assert {display["Class"] for display in rviz["Displays"]} == kinds
    assert rviz["Views"]["Current"]["Class"] == "rviz_default_plugins/Orbit"
    assert rviz["Enabled"] and "rviz_default_plugins/MoveCamera" in {tool["Class"] for tool in rviz["Tools"]}
    for display in rviz["Displays"]:
        topic = display.get("Topic") or display.get("Description Topic") or {}
        assert set(topic) <= {"Value", "Depth", "Reliability Policy", "Durability Policy", "History Policy"}
        assert topic.get("Reliability Policy", "Reliable") in ("Reliable", "Best Effort")
        assert topic.get("Durability Policy", "Volatile") in ("Volatile", "Transient Local")
    layout = json.loads((CONFIG / "episode.foxglove.json").read_text())
    panels = {name.partition("!")[0] for name in layout["configById"]}
    assert panels == {"3D", "Image", "StateTransitions", "Plot", "DiagnosticSummary"}
    for config in layout["configById"].values():
        for path in config.get("paths", ()):
            assert path["timestampMethod"] in ("receiveTime", "headerStamp") and path["value"].startswith("/")


def test_layouts_name_topics_that_there_are():
    known = {f"/{name}" for name in BY_NAME} | {"/scene_markers", "/robot_description", "/corners"}
    rviz = yaml.safe_load((CONFIG / "episode.rviz").read_text())["Visualization Manager"]
    displays = [d.get("Topic") or d.get("Description Topic") for d in rviz["Displays"]]
    assert {topic["Value"] for topic in displays if topic} <= known and rviz["Global Options"][
        "Fixed Frame"
    ] == "panda_link0"
    layout = json.loads((CONFIG / "episode.foxglove.json").read_text())
    used = set(re.findall(r'"(/[a-z_/]+)', json.dumps(layout["configById"])))
    assert used and used <= known

    def panels(node) -> set:
        return {node} if isinstance(node, str) else panels(node["first"]) | panels(node["second"])

    assert panels(layout["layout"]) == set(layout["configById"])


RVIZ_TYPES = {
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
    "RobotModel": "std_msgs/msg/String",
    "Pose": "geometry_msgs/msg/PoseStamped",
    "Image": "sensor_msgs/msg/Image",
}


@pytest.mark.slow
def test_layouts_fit_a_running_graph(graph, probe):
    """Each display is given its type with a quality of service that it can have, and each path of a panel is a field."""
    names = {
        graph.run("np_sim_bridge", "sim_bridge", {"camera": False}),
        graph.run("np_policy", "episode"),
        graph.run("np_policy", "post_contact"),
        graph.run("np_bringup", "robot_state"),
    }
    shown = probe.collect("scene_markers", MarkerArray, qos.REALTIME_SUBSCRIBER)
    probe.wait_until_ready(names)
    probe.wait_until(lambda: shown, what="markers")
    rviz = yaml.safe_load((CONFIG / "episode.rviz").read_text())["Visualization Manager"]
    assert {marker.header.frame_id for marker in shown[-1].markers} == {rviz["Global Options"]["Fixed Frame"]}

    def published(topic: str):
        probe.wait_until(lambda: probe.node.get_publishers_info_by_topic(topic), what=f"a publisher of {topic}")
        (found,) = probe.node.get_publishers_info_by_topic(topic)
        return found

    checked = 0
    for display in rviz["Displays"]:
        if topic := display.get("Topic") or display.get("Description Topic"):
            publisher = published(topic["Value"])
            assert publisher.topic_type == RVIZ_TYPES[display["Class"].partition("/")[2]]
            offered = publisher.qos_profile.reliability, publisher.qos_profile.durability
            strictest = ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL
            asked_for = topic["Reliability Policy"] == "Reliable", topic["Durability Policy"] == "Transient Local"
            assert all(o == s or not wanted for o, s, wanted in zip(offered, strictest, asked_for)), topic["Value"]
            checked += 1
    panels = json.loads((CONFIG / "episode.foxglove.json").read_text())["configById"]
    for config in panels.values():
        for topic in config.get("topics", ()):
            assert published(topic).topic_type in RVIZ_TYPES.values()
        for path in config.get("paths", ()):
            topic, *fields = path["value"].split(".")
            assert isinstance(value_at(published(topic).topic_type, fields), (str, float)), path
            checked += 1
    assert published(panels["Image!camera"]["imageMode"]["imageTopic"]).topic_type == RVIZ_TYPES["Image"]
    assert checked == 9
    diagnostics = probe.node.get_publishers_info_by_topic(panels["DiagnosticSummary!nodes"]["topicToRender"])
    assert {info.topic_type for info in diagnostics} == {"diagnostic_msgs/msg/DiagnosticArray"}


def value_at(message_type: str, fields: list[str]) -> object:
    """What a path such as ["status[0]", "message"] leads to in a message of a type with one entry in each of its lists."""
    kind = find_message_class(message_type)
    for field in fields:
        name, indexed, _ = field.partition("[")
        declared = kind.get_fields_and_field_types()[name]
        assert declared.startswith("sequence<") == bool(indexed), field
        inner = declared.removeprefix("sequence<").removesuffix(">")
        if "/" not in inner:
            return {"string": "", "double": 0.0}[inner]
        kind = find_message_class(inner.replace("/", "/msg/"))
    raise AssertionError(f"{fields} is no number and no text")


def test_every_setting_of_the_layout_is_one_that_foxglove_has():
    """Its own SDK knows the settings of every panel; it is asked where somebody has installed it."""
    panels = pytest.importorskip("foxglove.layouts", reason="pip install foxglove-sdk")
    kinds = {
        "3D": panels.ThreeDeeConfig,
        "Image": panels.ImageConfig,
        "StateTransitions": panels.StateTransitionsConfig,
        "Plot": panels.PlotConfig,
        "DiagnosticSummary": panels.DiagnosticsSummaryConfig,
    }
    topics = {
        "/scene_markers": panels.BaseRendererRosMarkerTopicSettings,
        "/target_pose": panels.BaseRendererPoseTopicSettings,
        "/robot_description": panels.BaseRendererUrdfTopicSettings,
    }
    series = {"Plot": panels.PlotSeries, "StateTransitions": panels.StateTransitionsSeries}

    def check(settings, kind, **needed):
        unknown = set(settings) - set(kind(**needed)._to_dict())
        assert not unknown, f"{kind.__name__}: {unknown}"

    for name, config in json.loads((CONFIG / "episode.foxglove.json").read_text())["configById"].items():
        panel = name.partition("!")[0]
        check(config, kinds[panel])
        check(config.get("imageMode", {}), panels.ImageModeConfig)
        check(config.get("cameraState", {}), panels.ThreeDeeCameraState)
        for topic, settings in config.get("topics", {}).items():
            check(settings, topics[topic])
        for layer in config.get("layers", {}).values():
            check(layer, panels.BaseRendererGridLayerSettings)
        for path in config.get("paths", ()):
            check(path, series[panel], value="/topic.field")
