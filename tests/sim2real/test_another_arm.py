"""An arm of six hinges that is no Panda: from 100 to 1,000 rows a second, against its model and against itself, by torque and by
motor current."""

import json
from dataclasses import replace

import numpy as np
import pytest
from arm_generator import record as panda_log
from rclpy.serialization import serialize_message
from sim2real.arm import rigid_body as rigid
from sim2real.arm.files import load_arm
from sim2real.arm.model import panda
from sim2real.checks.plausibility import check_plausibility
from sim2real.cli import diagnose as command
from sim2real.diagnosis import diagnose, explain_gap
from sim2real.effects.patch import load_patch
from sim2real.recordings.motor_current import current_to_torque, estimate_torque_constants, mark_as_current
from sim2real.recordings.reading import ContractViolation, load_log
from sim2real.recordings.signals import Commands, Log
from sim2real.report.document import make_report, to_json
from sim2real.report.page import render
from six_hinges import MJCF, PER_AMPERE, RATE, URDF, Truth, record

from np_record.bag_writer import BagWriter
from np_record.recorder import Sequencer
from np_record.topics import BY_NAME
from np_ros.messages import joint_state_message

ARM = load_arm(MJCF, tip="tool")
LOADED = Truth(friction=((2, 0.8),), payload=0.4)
# Against the nominal arm: friction, damping, and every link 5 % heavier.
WRONG = Truth(friction=((1, 0.5), (4, 0.1)), damping=((3, 0.4),), error=0.05)


def log_of(folder, truth=Truth(), name="log", **how):
    np.savez(folder / f"{name}.npz", **record(truth, **how))
    return load_log(folder / f"{name}.npz", ARM.joints)


def named(diagnosis):
    return {(f.effect.id, f.component): f.parameters for f in diagnosis.findings if f.is_chosen}


def assert_loaded(found, within=0.03):
    assert set(found) == {("payload", "arm"), ("coulomb_friction", "shoulder")}
    for value, true in (
        (found["payload", "arm"]["mass"], LOADED.payload),
        (found["coulomb_friction", "shoulder"]["level"], 0.8),
    ):
        assert value.value == pytest.approx(true, rel=within) and value.low < true < value.high


@pytest.mark.parametrize("rate", [50, 1000])  # 250 where an arm is strong, or from URDF
@pytest.mark.slow
def test_an_arm_is_well_or_is_not_at_any_rate(tmp_path, rate):
    well = log_of(tmp_path, rate=rate)
    check_plausibility(well, ARM)
    if rate == 50:  # at 1,000 by current, below
        assert explain_gap([well], ARM).verdict == "no_gap"
    assert_loaded(named(explain_gap([log_of(tmp_path, LOADED, rate=rate)], ARM)))


@pytest.mark.parametrize("seed", [0, 1])
def test_noisy_speeds_of_few_rows_a_second_are_no_pattern(tmp_path, seed):
    """Accelerations of the past tell the noise of the present one, which is in the residual of r2 as well."""
    log = log_of(tmp_path, rate=100, seed=seed, noise=seed + 3, encoders=True)
    check_plausibility(log, ARM)
    diagnosis = explain_gap([log], ARM)
    assert diagnosis.verdict == "no_gap" and not named(diagnosis)


def test_the_decimals_of_a_file_are_no_encoder_steps(tmp_path):
    rows = record(rate=125)
    np.savez(tmp_path / "log.npz", **{**rows, "q_rad": np.round(rows["q_rad"], 4)})
    assert explain_gap([load_log(tmp_path / "log.npz", ARM.joints)], ARM).verdict == "no_gap"


@pytest.mark.slow
def test_a_strong_arm_may_have_more_of_an_effect(tmp_path):
    """Bounds are made for the Panda's 87 Nm; this joint has 140."""
    found = named(explain_gap([log_of(tmp_path, Truth(payload=7.0), rate=250)], ARM))
    assert found["payload", "arm"]["mass"].value == pytest.approx(7.0, rel=0.01)


@pytest.mark.slow
def test_an_arm_from_urdf_is_diagnosed_like_that_from_mjcf(tmp_path):
    arm = load_arm(URDF, tip="tool")
    well = log_of(tmp_path, Truth(rotors=False), rate=250)
    assert explain_gap([well], arm).verdict == "no_gap"
    assert_loaded(named(explain_gap([log_of(tmp_path, replace(LOADED, rotors=False), rate=250)], arm)))


def test_rotors_of_which_a_urdf_does_not_tell_are_found(tmp_path):
    found = named(explain_gap([log_of(tmp_path, rate=250)], load_arm(URDF)))
    assert {effect for effect, _ in found} == {"armature"}
    sizes = [found["armature", joint]["inertia"].value for joint in ARM.joints]
    assert np.allclose(sizes, ARM.armature, rtol=0.03)


@pytest.mark.parametrize("is_current", [False, True])
@pytest.mark.slow
def test_what_changed_is_found_in_an_arm_of_which_no_model_is_right(tmp_path, is_current):
    def recorded(truth, noise):
        return log_of(tmp_path, truth, rate=200, noise=noise, current=is_current)

    before = recorded(WRONG, 5)
    later = {
        "nothing": recorded(WRONG, 6),
        "both": recorded(replace(WRONG, friction=(*WRONG.friction, (2, 0.8)), payload=0.4), 7),
    }
    if is_current:
        known = estimate_torque_constants([before], ARM)
        before, later = (
            current_to_torque(before, known),
            {name: current_to_torque(log, known) for name, log in later.items()},
        )
    found = {name: explain_gap([log], ARM, reference=[before]) for name, log in later.items()}
    assert found["nothing"].verdict == "no_gap"
    both = named(found["both"])
    assert set(both) == {("coulomb_friction", "shoulder"), ("payload", "arm")}
    # Constants are told by the model's masses: sizes are known no better than those.
    within = 0.06 if is_current else 0.02
    assert both["coulomb_friction", "shoulder"]["level"].value == pytest.approx(0.8, rel=within)
    assert both["payload", "arm"]["mass"].value == pytest.approx(0.4 * 1.05, rel=within)


@pytest.mark.slow
def test_motor_current_tells_its_constants_and_the_effects_and_no_torque_scale(tmp_path):
    for truth in (Truth(), LOADED):
        log = log_of(tmp_path, truth, current=True)
        diagnosis = explain_gap([current_to_torque(log, estimate_torque_constants([log], ARM))], ARM)
        constants = diagnosis.context.logs[0].per_ampere
        assert np.allclose(constants, PER_AMPERE, rtol=0.01)
        assert "torque_scale" not in {c.effect.id for c in diagnosis.design.candidates}
        if truth is LOADED:
            assert_loaded(named(diagnosis))
        else:
            assert diagnosis.verdict == "no_gap"


def test_a_known_constant_makes_current_a_torque(tmp_path):
    rows = record(current=True, rate=100, duration=5.0)
    np.savez(tmp_path / "known.npz", **rows, torque_per_ampere=PER_AMPERE)
    log = load_log(tmp_path / "known.npz", ARM.joints)
    assert not log.is_current and log.per_ampere is None
    assert np.allclose(log.torque, rows["current_A"] * PER_AMPERE)
    np.savez(tmp_path / "odd.npz", **rows, torque_per_ampere=PER_AMPERE[:5])
    with pytest.raises(ContractViolation, match="torque_per_ampere: expected 6 numbers above 0"):
        load_log(tmp_path / "odd.npz", ARM.joints)


def test_constants_may_be_given_with_a_recording(tmp_path, capsys):
    log_of(tmp_path, LOADED, current=True, rate=125, duration=30.0)
    arguments = [str(tmp_path / "log.npz"), "--model", str(MJCF), "--tip", "tool", "--quick", "--out", str(tmp_path)]
    constants = ["--torque-per-ampere", *map(str, PER_AMPERE)]
    assert command.main([*arguments, *constants]) == 0
    assert "payload at arm" in json.loads(capsys.readouterr().out.splitlines()[-1])["effects"]
    notes = json.loads((tmp_path / "report.json").read_text())["notes"]
    assert not any("were estimated from the recording" in note for note in notes)
    assert command.main([*arguments, *constants[:-1]]) == 1
    assert "expected 6 torque constants" in capsys.readouterr().err
    assert command.main([*arguments, *constants, "--effort", "sensor"]) == 1


@pytest.mark.slow
def test_a_joint_whose_current_does_not_tell_its_constant_is_not_judged(tmp_path):
    log = log_of(tmp_path, LOADED, current=True)
    noise = np.random.default_rng(0).normal(size=len(log.time))
    log = replace(log, torque=np.where(np.arange(6) == 5, noise[:, None], log.torque))
    diagnosis = diagnose([log], ARM)
    assert_loaded(named(diagnosis))
    assert not diagnosis.gap.moved[5] and np.isnan(diagnosis.context.logs[0].per_ampere[5])
    report = make_report(diagnosis, [log], 0.0)
    assert any("constant of wrist_3" in note for note in report["notes"])
    to_json(report)
    assert "constant of wrist_3" in render(report, diagnosis)


def test_a_current_that_tells_nothing_is_refused(tmp_path):
    log = log_of(tmp_path, current=True, rate=100, duration=10.0)
    still = replace(log, velocity=0 * log.velocity, position=0 * log.position + log.position[:1])
    with pytest.raises(ValueError, match="current: .*too little motion \\(waist\\).*torque_per_ampere"):
        estimate_torque_constants([still], ARM)
    with pytest.raises(ValueError, match="current of wrist_1: expected one that grows"):
        estimate_torque_constants([replace(log, torque=log.torque * np.where(np.arange(6) == 3, -1, 1))], ARM)


@pytest.mark.slow
def test_the_command_says_what_could_not_be_told_and_whose_the_patch_is(tmp_path, capsys):
    log_of(tmp_path, Truth(payload=0.4), current=True, rate=125)
    arguments = ["--model", str(MJCF), "--tip", "tool", "--joints", *ARM.joints, "--out", str(tmp_path / "out")]
    assert command.main([str(tmp_path / "log.npz"), *arguments]) == 0
    said = capsys.readouterr()
    assert "arm six_hinges: waist, shoulder" in said.err
    assert json.loads(said.out.splitlines()[-1])["effects"] == ["payload at arm"]
    notes = " ".join(json.loads((tmp_path / "out" / "report.json").read_text())["notes"])
    for text in (
        "elbow 10.",
        "torque scale of a joint cannot be distinguished",
        "not tried in the closed loop",
        "another arm",
    ):
        assert text in notes and text in (tmp_path / "out" / "report.html").read_text()
    with pytest.raises(ValueError, match="patch of the panda.*got one of 'six_hinges'"):
        load_patch(tmp_path / "out" / "patch.yaml")
    assert command.main([str(tmp_path / "log.npz"), "--tip", "tool", "--out", str(tmp_path / "no")]) == 1
    assert "expected --model" in capsys.readouterr().err
    assert command.main([str(tmp_path / "log.npz"), "--model", str(MJCF), "--joints", "waist", "--out", "no"]) == 2
    assert "q_rad: expected shape" in capsys.readouterr().err


def commanded(truth=Truth(), rate=250, scale=None):
    """A log with the commands of a controller that nobody knows, torques without gravity; scale: gain of a drive."""
    fine, quiet = record(truth), record(truth, silent=True)
    half = RATE // rate // 2
    rows = np.arange(half, len(fine["t_s"]) - half, 2 * half)
    q, dq = fine["q_rad"], fine["dq_rad_s"]
    gravity = rigid.gravity_torque(ARM, q)
    given, measured = quiet["tau_J_Nm"] - gravity, fine["tau_J_Nm"] - gravity
    time = fine["t_s"][rows]
    asked = given[rows + half]
    if scale is not None:  # of all that the drive gives
        asked = (given + gravity)[rows + half] / scale - gravity[rows + half]
    zeros = np.zeros_like(asked)
    commands = Commands(np.arange(len(rows)), q[rows], zeros, asked, time + 0.5 / rate, zeros, zeros, has_law=False)
    return Log("bag", time, q[rows], dq[rows], measured[rows - half], time - 0.5 / rate, False, commands)


@pytest.mark.slow
def test_commands_of_a_controller_that_nobody_knows_tell_the_drive():
    assert explain_gap([commanded()], ARM).verdict == "no_gap"
    diagnosis = explain_gap([commanded(LOADED, scale=np.array([1, 1, 1.05, 1, 1, 1]))], ARM)
    found = named(diagnosis)
    assert found.pop(("torque_scale", "elbow"))["scale"].value == pytest.approx(0.05, rel=0.1)
    assert_loaded(found)
    assert "r0" not in {cell.name for cell in diagnosis.design.cells}


def bag_of(path, log, names):
    """A bag of a log's joints under these names, those that are none of the arm at zero."""
    writer = BagWriter(path, {})
    sequencer = Sequencer(writer.write)
    c = log.commands
    for i, at in enumerate(np.round(1e9 * (log.time - log.time[0])).astype(int).tolist()):
        rows = {
            "joint_states": (log.position, log.velocity, log.torque),
            "effort_command": (c.target, c.target_velocity, c.torque),
        }
        for n, (topic, parts) in enumerate(rows.items()):
            arrays = [[dict(zip(ARM.joints, values[i])).get(name, 0.0) for name in names] for values in parts]
            message = serialize_message(joint_state_message(at, names, *np.array(arrays)))
            sequencer.add(BY_NAME[topic], message, 2 * i + n)
    sequencer.flush()
    writer.close()
    return path


def test_a_bag_of_another_arm_may_name_more_joints_in_another_order(tmp_path):
    log = commanded(rate=125)
    names = ["finger", *ARM.joints[::-1]]
    found = load_log(bag_of(tmp_path / "bag", log, names), ARM.joints)
    assert np.allclose(found.position, log.position) and np.allclose(found.torque, log.torque)
    assert np.allclose(found.commands.torque, log.commands.torque) and not found.commands.has_law
    assert found.torque_time[0] == pytest.approx(-0.004)
    current = mark_as_current(found)
    assert current.is_current and current.with_gravity and current.commands is None
    with pytest.raises(ContractViolation, match="expected each joint once in a message, wrist_3 is not in"):
        load_log(bag_of(tmp_path / "short", log, ["finger", *ARM.joints[:5]]), ARM.joints)


def test_seven_joints_of_any_name_are_an_arm():
    arm = replace(panda(), joints=tuple(f"axis_{n}" for n in range(7)), name="seven")
    diagnosis = explain_gap([panda_log()], arm)
    assert diagnosis.verdict == "no_gap" and diagnosis.context.arm.joints[0] == "axis_0"
