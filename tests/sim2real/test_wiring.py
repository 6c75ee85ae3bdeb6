"""Wrong conventions are named, and recordings without them are not accused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from arm_generator import Truth, at, record
from sim2real.arm.model import panda
from sim2real.arm.rigid_body import inverse_dynamics
from sim2real.cli import diagnose as command
from sim2real.wiring.check import find_wiring_fault
from sim2real.wiring.clocks import find_clock_fault
from sim2real.wiring.picture import PICTURES, corner_orders, find_keypoint_fault
from sim2real.wiring.target_poses import find_target_pose_fault

from np_common.rotations import matrix_from_quaternion, quaternion_from_matrix, yaw_quaternion
from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA
from np_description.domains import BUMP, CARD
from np_description.keypoints import box_keypoints
from np_description.panda import NOMINAL

ARM = panda()
SWAPPED = [0, 1, 2, 4, 3, 5, 6]
NEGATED = np.array([1, 1, 1, 1, 1, -1, 1])


@pytest.fixture(scope="module")
def log():
    """An arm with a load and friction of its own."""
    return record(Truth(payload=0.8, viscous=at(2, 2.0), coulomb_positive=at(4, 0.8)), duration=16.0)


WRIST = np.array([1, 1, 1, 1, 1, 0, 1])


def commanded(log, **changes):
    return replace(log, commands=replace(log.commands, **changes))


def weight(log):
    return inverse_dynamics(ARM, log.position)


def wrapped(position, joint):
    """Positions (n, 7) of which a joint's are counted down by a turn where they are above their middle."""
    above = (position > np.median(position, axis=0)) & (np.arange(7) == joint)
    return position - 2 * np.pi * above


FAULTS = {
    "clean": (lambda log: log, None),
    "swapped effort": (lambda log: replace(log, torque=log.torque[:, SWAPPED]), ("swap", (3, 4))),
    "swapped command": (lambda log: commanded(log, torque=log.commands.torque[:, SWAPPED]), ("swap", (3, 4))),
    "negated position": (lambda log: replace(log, position=log.position * NEGATED), ("sign", (5,))),
    "negated effort": (lambda log: replace(log, torque=log.torque * NEGATED, commands=None), ("sign", (5,))),
    "degrees": (lambda log: replace(log, position=np.degrees(log.position)), ("degrees", ())),
    "gains": (
        lambda log: commanded(log, stiffness=4 * log.commands.stiffness, damping=2 * log.commands.damping),
        ("gains", ()),
    ),
    "no velocity": (lambda log: replace(log, velocity=0 * log.velocity), ("constant", tuple(range(7)))),
    "no effort of a joint": (lambda log: replace(log, torque=log.torque * WRIST), ("constant", (5,))),
    "wrapped position": (lambda log: replace(log, position=wrapped(log.position, 4)), ("jump", (4,))),
    "effort with the weight": (lambda log: replace(log, torque=log.torque + weight(log)), ("gravity", ())),
    "torque without the weight": (lambda log: replace(log, commands=None, with_gravity=True), ("gravity", ())),
    "torque with the weight": (
        lambda log: replace(log, torque=log.torque + weight(log), commands=None, with_gravity=True),
        None,
    ),
    "currents": (
        lambda log: replace(
            log, torque=(log.torque + weight(log)) / 9, commands=None, with_gravity=True, is_current=True
        ),
        None,
    ),
    "late velocity": (lambda log: replace(log, velocity=np.roll(log.velocity, 1, axis=0)), ("delay", ())),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_of_the_joints_is_named_and_a_load_is_none(log, name):
    change, expected = FAULTS[name]
    found = find_wiring_fault(change(log), ARM)
    named = None if found is None else (found.kind, tuple(ARM.joints.index(joint) for joint in found.joints))
    assert named == expected


@pytest.fixture(scope="module")
def targets(log):
    """(log, stamps s, poses (n, 7) as sent) of targets that lead the arm, held for 0.1 s each."""
    stamps = np.arange(1.0, 15.0, 0.1)
    rows = np.searchsorted(log.time, stamps)
    joints = log.position[rows] + 0.05 * np.sin(np.arange(7) + stamps[:, None])
    target = log.commands.target.copy()
    for row, value in zip(rows, joints):
        target[row : row + 50] = value
    position, rotation = forward_kinematics(joints)
    quaternion = quaternion_from_matrix(rotation)
    return commanded(log, target=target), stamps, np.column_stack([position, quaternion[:, 1:], quaternion[:, :1]])


def frame_of_the_hand(poses, measured):
    turn = matrix_from_quaternion(poses[:, [6, 3, 4, 5]])
    return np.column_stack([poses[:, :3] - turn @ NOMINAL.frames["hand_tcp"].position, poses[:, 3:]])


@pytest.mark.parametrize(
    "change, kind",
    [
        (lambda poses, measured: poses, None),
        (lambda poses, measured: poses[:, [0, 1, 2, 6, 3, 4, 5]], "quaternion"),
        (frame_of_the_hand, "frame"),
        (
            lambda poses, measured: np.column_stack([3 * poses[:, :3] - 2 * measured, poses[:, 3:]]),
            "action_scale",
        ),
    ],
)
def test_target_poses_are_held_against_what_the_controller_makes_of_them(targets, change, kind):
    log, stamps, poses = targets
    measured, _ = forward_kinematics(log.position[np.searchsorted(log.time, stamps)])
    found = find_target_pose_fault(log, stamps, change(poses, measured))
    assert (found and found.kind) == kind


@pytest.fixture(scope="module")
def pushed():
    """(keypoints (n, 8, 3), tool points (n, 3)) of a card that the hand pushes, with 0.5 px of noise."""
    rng, share = np.random.default_rng(3), np.linspace(0, 1, 60)
    centre = np.column_stack([0.45 + 0.1 * share, 0.15 - 0.1 * share, np.full(60, CARD.half_size[2])])
    half = np.asarray(CARD.half_size)
    corners = [CAMERA.project(box_keypoints(half, c, yaw_quaternion(np.asarray(0.3))))[0] for c in centre]
    pixels = np.array(corners) + 0.5 * rng.standard_normal((60, 8, 2))
    return np.concatenate([pixels, np.ones((60, 8, 1))], axis=-1), centre - [0.03, -0.02, 0.0]


def show(keypoints, turns, is_mirrored):
    last, (u, v, score) = CAMERA.width - 1, np.moveaxis(keypoints, -1, 0)
    u = last - u if is_mirrored else u
    for _ in range(turns):
        u, v = v, last - u
    return np.stack([u, v, score], axis=-1)


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_that_is_rotated_or_mirrored_is_named(pushed, name):
    keypoints, tip = pushed
    found = find_keypoint_fault(show(keypoints, *PICTURES[name]), CARD, tip)
    assert found.kind == "image" and name in found.sentence


@pytest.mark.parametrize("name", [name for name in corner_orders() if name != "in reverse"])
def test_corners_in_another_order_are_named(pushed, name):
    keypoints, tip = pushed
    found = find_keypoint_fault(keypoints[:, corner_orders()[name]], CARD, tip)
    assert found.kind == "corners"


def test_another_object_is_no_convention(pushed):
    keypoints, tip = pushed
    assert find_keypoint_fault(keypoints, CARD, tip) is None
    assert find_keypoint_fault(keypoints, BUMP, tip) is None


@pytest.mark.parametrize("moved, is_fault", [(0.0, False), (0.03, False), (40.0, True), (-1.0, True), (3600.0, True)])
def test_two_clocks_are_told_from_a_late_image(moved, is_fault):
    joints, images = (np.arange(0, 20 * 10**9, step, dtype=np.int64) for step in (2_000_000, 33_000_000))
    arrivals = {"joint_states": joints + 10**6, "keypoints": images + 4 * 10**7}
    headers = {"joint_states": joints, "keypoints": images + np.int64(1e9 * moved)}
    found = find_clock_fault(headers, arrivals)
    assert (found is not None) == is_fault and (not is_fault or found.stream == "keypoints")
    assert (find_clock_fault(headers, headers) is not None) == is_fault  # by a recorder that logs header stamps


def test_the_command_names_the_fault_and_diagnoses_nothing(tmp_path, log, capsys):
    gravity = np.array([3.0, -20, 1, 15, 1, 2, 0]) * np.cos(
        log.position
    )  # of some sign: enough to be explained by nothing
    path = tmp_path / "log.npz"
    columns = {
        "t_s": log.time,
        "q_rad": np.degrees(log.position),
        "dq_rad_s": log.velocity,
        "tau_J_Nm": log.torque + gravity,
    }
    np.savez(path, **columns)
    assert command.main([str(path), "--out", str(tmp_path / "out")]) == 2
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer["verdict"] == "wiring" and answer["kind"] == "degrees"
    assert [one.name for one in (tmp_path / "out").iterdir()] == ["wiring.json"]
    assert json.loads((tmp_path / "out" / "wiring.json").read_text()) == answer
