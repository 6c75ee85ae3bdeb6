"""The URDF against the scene it is read from, and against the kinematics that control runs with."""

import re
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from np_control.kinematics import forward_kinematics
from np_description.domains import DOMAINS
from np_description.drawing.robot import robot_bodies, roll_pitch_yaw, urdf, visual_shapes
from np_description.panda import JOINT_NAMES, NOMINAL, STATE_NAMES
from np_description.scene import load_model

URDF = urdf()


def read_by_mujoco() -> mujoco.MjModel:
    """The URDF as another program reads it, with the links that it would merge into their parents."""
    keep = '<mujoco><compiler fusestatic="false" discardvisual="false"/></mujoco>'
    return mujoco.MjModel.from_xml_string(re.sub(r'(<robot name="panda">)', rf"\1{keep}", URDF))


def test_joints_have_the_names_of_the_state_and_the_limits_of_the_arm():
    robot = ElementTree.fromstring(URDF)
    moving = [joint for joint in robot.iter("joint") if joint.get("type") != "fixed"]
    assert tuple(joint.get("name") for joint in moving) == STATE_NAMES
    for i, joint in enumerate(moving[:7]):
        limit = {key: float(value) for key, value in joint.find("limit").items()}
        assert joint.get("name") == JOINT_NAMES[i]
        assert limit["upper"] == pytest.approx(NOMINAL.position_upper[i])
        assert limit["effort"] == NOMINAL.torque_limit[i] and limit["velocity"] == NOMINAL.velocity_limit[i]


def test_another_reader_finds_every_link_where_the_kinematics_have_it():
    model, scene = read_by_mujoco(), load_model(DOMAINS["card"])
    read, own = mujoco.MjData(model), mujoco.MjData(scene)
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = np.append(rng.uniform(NOMINAL.position_lower, NOMINAL.position_upper), rng.uniform(0, 0.04, 2))
        for data, m in ((read, model), (own, scene)):
            data.qpos[[m.joint(name).qposadr[0] for name in STATE_NAMES]] = q
            mujoco.mj_kinematics(m, data)
        for name in robot_bodies(scene):
            if name in (model.body(i).name for i in range(model.nbody)):
                np.testing.assert_allclose(read.body(name).xpos, own.body(name).xpos, atol=1e-6)
        np.testing.assert_allclose(read.body("panda_tcp").xpos, forward_kinematics(q[:7])[0], atol=1e-6)


def test_mass_and_inertia_are_those_of_the_scene():
    model, scene = read_by_mujoco(), load_model(DOMAINS["card"])
    names = [name for name in robot_bodies(scene) if name != "panda_link0"]  # a fixed base has none for MuJoCo's reader
    for name in names:
        assert model.body(name).mass[0] == pytest.approx(scene.body(name).mass[0], rel=1e-6)
        np.testing.assert_allclose(model.body(name).inertia, scene.body(name).inertia, rtol=1e-4)


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=list(DOMAINS))
def test_every_body_of_a_scene_is_drawn(domain):
    model = load_model(domain)
    drawn = {shape.body for shape in visual_shapes(model)}
    assert drawn == {*robot_bodies(model), "world", "object"}
    boxes = [shape for shape in visual_shapes(model) if shape.body == "world" and shape.kind == "box"]
    assert len(boxes) == len(domain.obstacles)


def test_angles_of_a_turn_that_looks_straight_down():
    rng = np.random.default_rng(1)
    turns = [
        *rng.normal(size=(20, 4)),
        np.array([1, 0, 1, 0]),
        np.array([1, 0, -1, 0]),
        np.array([0.5, 0.5, 0.5, -0.5]),
    ]
    for quaternion in turns:
        quaternion = quaternion / np.linalg.norm(quaternion)
        roll, pitch, yaw = roll_pitch_yaw(quaternion)
        again = np.array([1.0, 0, 0, 0])
        for angle, axis in ((roll, [1.0, 0, 0]), (pitch, [0, 1.0, 0]), (yaw, [0, 0, 1.0])):
            turn, before = np.empty(4), again.copy()
            mujoco.mju_axisAngle2Quat(turn, np.array(axis), angle)
            mujoco.mju_mulQuat(again, turn, before)
        assert abs(again @ quaternion) == pytest.approx(1.0, abs=1e-7)
