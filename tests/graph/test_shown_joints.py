"""Viewers show this arm, whatever else is published on `joint_states`."""

from dataclasses import replace

import numpy as np
import pytest
from bag_variants import Variant, write_variant
from bags import record_episode
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import Image, JointState
from visualization_msgs.msg import MarkerArray

from np_bringup.view import window
from np_bringup.view.live import LiveGraph
from np_bringup.view.recorded import RecordedEpisode
from np_bringup.view.shown_joints import ArmNotNamed, ShownJoints
from np_control.kinematics import hand_pose
from np_description.domains import CARD
from np_description.drawing.scene_data import SceneData
from np_description.message_arrays import BadMessage
from np_description.panda import JOINT_NAMES, NOMINAL, STATE_NAMES
from np_record.bag import Recording
from np_ros import qos
from np_ros.messages import header_message

OTHERS = ("rail", "left_joint1", "other_joint1", "robotiq_finger", "fr3_joint1")
FINGERS = STATE_NAMES[7:]
POSITIONS = dict(zip(STATE_NAMES, [*NOMINAL.ready, 0.01, 0.02]))
FOREIGN = dict.fromkeys(OTHERS, 7.0)


def state(stamp: int, names, **changes) -> JointState:
    """A JointState with positions only, each that of its joint."""
    values = {**POSITIONS, **FOREIGN, **changes}
    return JointState(header=header_message(stamp, ""), name=[*names], position=[values[name] for name in names])


def shown(*messages) -> tuple[int, np.ndarray]:
    joints = ShownJoints(lambda message: message)
    for message in messages:
        joints.add(message)
    return joints.read()


@given(st.permutations([*STATE_NAMES, *OTHERS]), st.integers(0, 14))
def test_positions_go_with_their_names_in_any_order_and_in_two_parts(names, cut):
    stamp, positions = shown(state(1, names[:cut]), state(2, names[cut:]))
    assert positions.tolist() == [*POSITIONS.values()]
    assert stamp == (2 if set(names[cut:]) & set(JOINT_NAMES) else 1)


def test_the_newest_position_is_shown_and_the_arms_stamp():
    old = state(1, STATE_NAMES, panda_joint1=0.5, panda_finger_joint1=0.04)
    stamp, positions = shown(old, state(2, JOINT_NAMES), state(3, FINGERS), state(4, OTHERS))
    assert stamp == 2 and positions.tolist() == [*POSITIONS.values()]


def test_fingers_of_which_nothing_is_known_are_closed():
    for message in (state(1, JOINT_NAMES), state(1, STATE_NAMES, **dict.fromkeys(FINGERS, float("nan")))):
        assert shown(message)[1].tolist() == [*NOMINAL.ready, 0.0, 0.0]


def test_foreign_joints_are_not_judged():
    broken = JointState(name=["robotiq_finger", "robotiq_finger"], position=[])
    assert shown(state(1, STATE_NAMES), broken)[0] == 1


def test_what_cannot_be_shown_is_named():
    with pytest.raises(ArmNotNamed, match="expected panda_joint7 too, got panda_joint1, .*, panda_joint6, rail"):
        shown(state(1, [*JOINT_NAMES[:6], "rail"]))
    with pytest.raises(BadMessage, match="each joint once"):
        shown(state(1, [*STATE_NAMES, "panda_joint1"]))
    with pytest.raises(BadMessage, match="position: expected shape"):
        shown(JointState(name=[*STATE_NAMES], position=[0.0]))
    with pytest.raises(BadMessage, match="expected finite numbers"):
        shown(state(1, STATE_NAMES, panda_joint3=float("nan")))


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return record_episode(tmp_path_factory.mktemp("shown") / "bag", 300)


def rewritten(bag, path, joints: str):
    """The bag as somebody else would have written it."""
    plain = replace(Variant.draw(0), clock="header", joints=joints, qos="same", files=1, big_endian=False, twice=False)
    with Recording(bag) as recording:
        messages = [*recording.messages()]
    return write_variant(path, messages, plain, 0, "{}")


@pytest.mark.parametrize("joints", ["shuffled", "gripper", "nan"])
def test_a_bag_with_other_joints_too_is_shown_as_the_original(bag, tmp_path, joints):
    path = rewritten(bag, tmp_path / "bag", joints)
    arm = [i for i, body in enumerate(SceneData(CARD).bodies) if body.startswith("panda") and "finger" not in body]
    expected, got = (RecordedEpisode(str(each)).episode()["moments"] for each in (bag, path))
    assert [m["time"] for m in got] == [m["time"] for m in expected] and len(got) == 12 and arm
    assert [[m["poses"][i] for i in arm] for m in got] == [[m["poses"][i] for i in arm] for m in expected]
    with Recording(bag) as original, Recording(path) as variant:
        pairs = zip(window.moments(original), window.moments(variant), strict=True)
        for (time, expected), (other_time, got) in [*pairs][1:]:
            assert time == other_time and expected.joints[:7].tolist() == got.joints[:7].tolist()
            np.testing.assert_allclose(got.joints[7:], expected.joints[7:], atol=1e-3)  # said a message later


def test_a_graph_with_a_second_arm_and_a_gripper_is_shown(graph, probe):
    graph.run("np_bringup", "robot_state")
    live, markers = LiveGraph(probe, CARD), probe.collect("scene_markers", MarkerArray)
    probe.advertise("joint_states", JointState, qos.LOCKSTEP)
    probe.wait_until(lambda: probe.matched("joint_states", 2), what="both viewers")
    probe.publish("joint_states", state(1, OTHERS))
    probe.wait_until(lambda: "got rail, left_joint1" in live.state()["phase"], what="what is missing")

    def is_shown() -> bool:
        for stamp, names in ((5, [*OTHERS, *STATE_NAMES[::-1]]), (6, OTHERS)):
            probe.publish("joint_states", state(stamp, names))
        return bool(live.state()["poses"] and markers)

    probe.wait_until(is_shown, what="the arm")
    hand = live.state()["poses"][SceneData(CARD).bodies.index("panda_hand")][:3]
    np.testing.assert_allclose(hand, hand_pose(NOMINAL.ready)[0], atol=1e-4)
    assert markers[-1].markers[0].header.stamp.nanosec == 5


def test_an_image_that_cannot_be_read_is_named_on_the_page(probe):
    live = LiveGraph(probe, CARD)
    probe.advertise("camera/image_raw", Image)
    probe.wait_until(lambda: probe.matched("camera/image_raw"), what="the viewer")

    def is_named() -> bool:
        probe.publish("camera/image_raw", Image(height=1, width=1, step=2, encoding="16UC1", data=b"ab"))
        return live.image(0.0) is None and "camera/image_raw: Image.encoding: " in live.state()["phase"]

    probe.wait_until(is_named, what="the encoding")
    assert live.state()["phase"].endswith("got '16UC1'")

    def is_shown() -> bool:
        probe.publish("camera/image_raw", Image(height=1, width=1, step=3, encoding="bgr8", data=b"abc"))
        return live.image(0.0) is not None

    probe.wait_until(is_shown, what="an image")
    assert "16UC1" not in live.state()["phase"]
