"""Any arm of hinges from MJCF and URDF, and one clear line for what is none."""

from dataclasses import fields

import numpy as np
import pytest
from sim2real.arm.files import load_arm
from six_hinges import MJCF, URDF

JOINTS = ("waist", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3")
GRIPPER = """<body name="palm" pos="0 .12 0"><inertial mass=".5" pos="0 .03 0" diaginertia=".001 .001 .001"/>
  <body name="thumb"><inertial mass=".1" pos="0 .03 0" diaginertia=".0001 .0001 .0001"/>
    <joint name="thumb_slide" type="slide"/></body>
  <body name="finger"><inertial mass=".1" pos="0 .03 0" diaginertia=".0001 .0001 .0001"/>
    <joint name="finger_hinge"/></body>
  <body name="pad"><inertial mass=".1" pos="0 .03 0" diaginertia=".0001 .0001 .0001"/>
    <joint name="pad_hinge"/></body>
</body>"""


def written(folder, text, name="arm.xml"):
    (folder / name).write_text(text)
    return folder / name


def test_mjcf_and_urdf_of_an_arm_are_the_same_arm():
    one, other = load_arm(MJCF), load_arm(URDF)
    assert one.joints == other.joints == JOINTS and one.name == "six_hinges"
    assert one.torque_limit.tolist() == [140, 140, 140, 30, 30, 30]
    assert other.velocity_limit.tolist() == [2.1, 2.1, 2.6, 3.1, 3.1, 3.1]
    assert (one.armature > 0).all() and not other.armature.any()  # a URDF cannot say
    for field in fields(one):
        if field.name not in ("armature", "velocity_limit", "tip"):
            here, there = getattr(one, field.name), getattr(other, field.name)
            assert here == there if isinstance(here, (str, tuple)) else np.allclose(here, there, atol=1e-9), field.name


def test_the_tool_point_is_a_site_or_a_link():
    assert load_arm(MJCF, tip="tool").tip == pytest.approx([0, 0.12, 0])
    assert load_arm(URDF, tip="tool").tip == pytest.approx([0, 0.12, 0]) == load_arm(URDF).tip
    with pytest.raises(ValueError, match="carries as tool point, got 'elbow_link'"):
        load_arm(MJCF, tip="elbow_link")


def test_fingers_are_left_out_by_naming_the_arm(tmp_path):
    path = written(tmp_path, MJCF.read_text().replace('<site name="tool"', GRIPPER + '<site name="tool"'))
    with pytest.raises(ValueError, match="one chain of hinges.*--joints"):
        load_arm(path)
    arm = load_arm(path, JOINTS)
    assert arm.joints == JOINTS and arm.mass[-1] == pytest.approx(0.9 + 0.5 + 0.3)  # what it holds hangs on it
    assert load_arm(path, JOINTS[:3]).mass[-1] == pytest.approx(2.5 + 1.4 + 1.3 + 0.9 + 0.8)


@pytest.mark.parametrize(
    "joints, expected",
    [
        (["waist", "thumb_slide"], "got 'thumb_slide', a slide; it has waist .hinge."),
        (["waist", "knee"], "got 'knee', no joint of it"),
        (["elbow", "waist"], "from the base outwards"),
        (["thumb_slide"], "got 'thumb_slide', a slide"),
    ],
)
def test_joints_that_make_no_arm_are_refused(tmp_path, joints, expected):
    path = written(tmp_path, MJCF.read_text().replace('<site name="tool"', GRIPPER + '<site name="tool"'))
    with pytest.raises(ValueError, match=expected):
        load_arm(path, joints)


@pytest.mark.parametrize(
    "text, expected",
    [
        ("no model", "expected an MJCF or URDF file of an arm"),
        ("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", "expected hinges, got no joints"),
        (
            "<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='revolute'><parent link='a'/>"
            "<child link='b'/><axis xyz='0 0 1'/><limit lower='-1' upper='1' effort='9' velocity='1'/></joint></robot>",
            "mass",
        ),
        (
            "<mujoco><worldbody><body><joint name='a' axis='0 0 1'/><joint name='b' axis='0 1 0'/><geom size='.1'/>"
            "</body></worldbody></mujoco>",
            "one hinge a body",
        ),
    ],
)
def test_a_file_without_an_arm_is_refused_by_its_name(tmp_path, text, expected):
    path = written(tmp_path, text, "arm.urdf" if "robot" in text else "arm.xml")
    with pytest.raises(ValueError, match=expected) as refused:
        load_arm(path)
    assert str(path) in str(refused.value)


def test_an_arm_rests_in_its_key_posture_within_its_limits(tmp_path):
    text = MJCF.read_text().replace("</mujoco>", '<keyframe><key qpos="0 -1 1 -9 0 0"/></keyframe></mujoco>')
    assert load_arm(written(tmp_path, text)).rest.tolist() == [0, -1, 1, -3.1, 0, 0]
    assert not load_arm(MJCF).rest.any()


def test_a_motor_s_limit_counts_at_the_joint(tmp_path):
    text = MJCF.read_text().replace(
        "</mujoco>",
        '<actuator><motor joint="waist" gear="50" forcerange="-2 2" forcelimited="true"/>'
        '<motor joint="elbow" gear="50" forcerange="-4 4" forcelimited="true"/></actuator></mujoco>',
    )
    assert load_arm(written(tmp_path, text)).torque_limit[:3].tolist() == [100, 140, 140]
