"""Recordings that do not mean what they claim are refused, by name."""

import json
from dataclasses import replace

import numpy as np
import pytest
from arm_generator import Truth, record
from bags import record_episode
from rclpy.serialization import serialize_message
from sim2real.arm.model import panda
from sim2real.arm.nominal_prediction import predict_expected_torque
from sim2real.checks.plausibility import check_plausibility
from sim2real.cli import diagnose as command
from sim2real.recordings.reading import ContractViolation, load_log
from sim2real.recordings.signals import Log

from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_description.phases import PhaseState
from np_record.bag_writer import BagWriter
from np_record.recorder import Sequencer
from np_record.topics import BY_NAME, TIMELINE
from np_ros.messages import gains_message, joint_state_message

PERIOD = 2_000_000


@pytest.fixture(scope="module")
def log():
    friction = np.array([0.0, 0, 0, 0, 0.3, 0, 0])
    return record(Truth(coulomb_positive=friction, coulomb_negative=friction), duration=16.0)


def flipped(log, joint, *channels):
    sign = np.ones(7)
    sign[joint] = -1
    return replace(log, **{name: getattr(log, name) * sign for name in channels})


def exchanged(log, i, k, *channels):
    order = np.arange(7)
    order[[i, k]] = order[[k, i]]
    return replace(log, **{name: getattr(log, name)[:, order] for name in channels})


def test_friction_is_no_violation(log):
    check_plausibility(log)


@pytest.mark.parametrize(
    "break_it, text",
    [
        (
            lambda log: replace(log, position=np.degrees(log.position), velocity=np.degrees(log.velocity)),
            "degrees",
        ),
        (lambda log: replace(log, velocity=np.degrees(log.velocity)), "degrees"),
        (lambda log: flipped(log, 3, "position", "velocity", "torque"), "reversed sign"),
        (lambda log: flipped(log, 1, "velocity"), "derivative of position"),
        (lambda log: flipped(log, 1, "torque"), "panda_joint2 with reversed sign"),
        (lambda log: flipped(log, 6, "torque"), "panda_joint7 with reversed sign"),
        (lambda log: exchanged(log, 0, 2, "velocity"), "derivative of position"),
        (lambda log: exchanged(log, 0, 2, "torque"), "panda_joint1 and panda_joint3 exchanged"),
        (
            lambda log: exchanged(log, 0, 2, "position", "velocity", "torque"),
            "panda_joint1 and panda_joint3 exchanged",
        ),
    ],
)
def test_wrong_units_signs_and_order_are_named(log, break_it, text):
    with pytest.raises(ContractViolation, match=text):
        check_plausibility(break_it(log))


def swinging(joint, amplitude, hertz):
    """A log of 4 s of the nominal arm, one joint of which swings about the ready posture."""
    arm, time = panda(), np.arange(2000) * 0.002
    q, dq, ddq = np.tile(arm.rest, (2000, 1)), np.zeros((2000, 7)), np.zeros((2000, 7))
    angle, omega = 2 * np.pi * hertz * time, 2 * np.pi * hertz
    q[:, joint] += amplitude * np.sin(angle)
    dq[:, joint], ddq[:, joint] = amplitude * omega * np.cos(angle), -amplitude * omega**2 * np.sin(angle)
    torque = predict_expected_torque(q, dq, ddq, arm, True)
    return Log("swinging", time, q, dq, torque, time, True)


def test_an_arm_that_swings_faster_than_it_may_is_no_violation():
    """As one does whose torque rate is limited: beyond its speed nearly all the time, and in radians."""
    log = swinging(6, 0.06, 20.0)
    assert np.percentile(np.abs(log.velocity[:, 6]), 50) > 1.5 * panda().velocity_limit[6]
    check_plausibility(log)


def test_a_joint_in_degrees_that_stays_in_its_range_is_betrayed_by_its_torques():
    log = swinging(0, 0.04, 1.0)
    check_plausibility(log)
    factor = np.where(np.arange(7) == 0, np.degrees(1.0), 1.0)
    with pytest.raises(ContractViolation, match="panda_joint1.*degrees"):
        check_plausibility(replace(log, position=log.position * factor, velocity=log.velocity * factor))


@pytest.fixture(scope="module")
def short(log):
    rows = slice(0, 800)
    commands = replace(
        log.commands,
        **{
            name: getattr(log.commands, name)[rows]
            for name in ("rows", "target", "target_velocity", "torque", "torque_time", "stiffness", "damping")
        },
    )
    return replace(
        log,
        commands=commands,
        **{name: getattr(log, name)[rows] for name in ("time", "position", "velocity", "torque", "torque_time")},
    )


def bag(path, log, names=STATE_NAMES, period=PERIOD, skip=(), effort_command=True, topic="joint_states"):
    writer = BagWriter(path, {})
    sequencer = Sequencer(writer.write)
    hand = np.zeros(2)
    if log.commands is not None and log.commands.has_law:
        gains = gains_message(np.stack([log.commands.stiffness[0], np.ones(7)]))
        sequencer.add(BY_NAME["target_gains"], serialize_message(gains), 1)
    for i in range(len(log.time)):
        if i in skip:
            continue
        state = [np.concatenate([values[i], hand]) for values in (log.position, log.velocity, log.torque)]
        sequencer.add(BY_NAME[topic], serialize_message(joint_state_message(i * period, names, *state)), 2 * i)
        if effort_command:
            c = log.commands
            answer = joint_state_message(i * period, JOINT_NAMES, c.target[i], c.target_velocity[i], c.torque[i])
            sequencer.add(BY_NAME["effort_command"], serialize_message(answer), 2 * i + 1)
    assert TIMELINE.name == "joint_states"
    sequencer.flush()
    writer.close()
    return path


def test_a_bag_is_read_as_it_was_recorded(tmp_path, short):
    log = short
    found = load_log(bag(tmp_path / "bag", log))
    for name in ("position", "velocity", "torque"):
        np.testing.assert_array_equal(getattr(found, name), getattr(log, name))
    np.testing.assert_allclose(found.time, log.time, atol=1e-12)
    np.testing.assert_allclose(found.torque_time, log.torque_time, atol=1e-12)
    np.testing.assert_array_equal(found.commands.torque, log.commands.torque)
    np.testing.assert_allclose(found.commands.damping, log.commands.damping)
    assert not found.with_gravity
    assert load_log(bag(tmp_path / "mute", log, effort_command=False)).commands is None


@pytest.mark.parametrize(
    "options, text",
    [
        (dict(names=("rail", "slide", *STATE_NAMES[2:])), "panda_joint1, panda_joint2 is not in"),
        (dict(period=2 * PERIOD), "500 Hz, got 250"),
        (dict(skip=range(0, 800, 9)), "missing"),
        (dict(topic="motor_states"), "joint_states"),
    ],
)
def test_bags_that_break_the_graph_contract_are_refused(tmp_path, short, options, text):
    with pytest.raises(ContractViolation, match=text):
        load_log(bag(tmp_path / "bag", short, **options))


def test_the_command_writes_both_reports_and_refuses_with_status_2(tmp_path, log, capsys):
    path = bag(tmp_path / "episode", log)
    assert command.main([str(path), "--out", str(tmp_path / "out")]) == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer["effects"] == ["coulomb_friction at panda_joint5"]
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["verdict"] in ("identified", "ambiguous")
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("<svg") == 3 and 'src="http' not in page
    assert "so that this one is named" in page and "outweighs a fault of one small joint" in page
    assert command.main([str(tmp_path / "nothing"), "--out", str(tmp_path / "none")]) == 2
    assert "does not exist" in capsys.readouterr().err and not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    "change, text",
    [
        (dict(tau_J_Nm=None), "tau_J_Nm missing"),
        (dict(q_rad=np.zeros((9, 6))), "shape"),
        (dict(t_s=np.zeros(1000)), "increase"),
        (dict(dq_rad_s=np.full((1000, 7), np.nan)), "finite"),
        (dict(joint_names=np.array(JOINT_NAMES[::-1])), "joint_names: expected panda_joint1, .* got panda_joint7, "),
    ],
)
def test_npz_files_that_lack_something_are_refused(tmp_path, change, text):
    with pytest.raises(ContractViolation, match=text):
        load_log(npz_file(tmp_path, change))


def test_arrays_that_nobody_asked_for_do_not_refuse_a_file(tmp_path):
    others = {"joint_names": np.array(JOINT_NAMES), "operator": np.array("A"), "notes": np.array([None], object)}
    assert load_log(npz_file(tmp_path, others)).position.shape == (1000, 7)


def test_a_file_of_another_kind_is_named_as_such(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,q1\n0,1\n")
    with pytest.raises(ContractViolation, match="log.csv: expected a rosbag2 folder or an .npz file"):
        load_log(path)


def npz_file(tmp_path, change):
    """A file of an arm at rest with these arrays added or exchanged, without those that are None."""
    columns = (
        dict(
            t_s=np.arange(1000) * 1e-3,
            q_rad=np.zeros((1000, 7)),
            dq_rad_s=np.zeros((1000, 7)),
            tau_J_Nm=np.zeros((1000, 7)),
        )
        | change
    )
    path = tmp_path / "log.npz"
    np.savez(path, **{name: values for name, values in columns.items() if values is not None})
    return path


def test_an_episode_in_which_the_hand_pushes_is_no_free_motion(tmp_path, capsys):
    phases = {0: PhaseState("pre"), 50: PhaseState("approach"), 100: PhaseState("post"), 180: PhaseState("succeeded")}
    bag = record_episode(tmp_path / "bag", 200, phases)
    assert command.main([str(bag), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "expected free motion of the arm, got a pushing episode" in said and "`diagnose_task` reads it" in said
    assert not (tmp_path / "out").exists()
