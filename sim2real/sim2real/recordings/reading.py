"""Recordings to logs. Fails closed: what breaks the contract of docs/reference/graph.md is no evidence of friction.

Messages are read in bulk from their bytes (np_record.bulk), three minutes at 500 Hz in a quarter of a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from np_control.impedance import damping
from np_description.control_rate import SECOND
from np_description.panda import JOINT_NAMES
from np_record.bag import BagError, Recording, TopicMessages
from np_record.bulk import has_joint, read_joint_positions, read_joint_states
from np_record.recorded_phases import PHASE_TOPICS, read_phase_changes
from sim2real.recordings.fresh_rows import find_fresh_rows
from sim2real.recordings.loop_record import read_loop_record
from sim2real.recordings.loop_timing import find_loop_timing
from sim2real.recordings.signals import Commands, Log
from sim2real.thresholds import THRESHOLDS

RECORDINGS = THRESHOLDS.recordings

PERIOD = 0.002  # s between joint states
NPZ_KEYS = {"t_s": 1, "q_rad": 2, "dq_rad_s": 2, "tau_J_Nm": 2}  # name: dimensions
CURRENT_KEYS = {"t_s": 1, "q_rad": 2, "dq_rad_s": 2, "current_A": 2}
PD_KEYS = {
    "time": 1,
    "dof_pos": 2,
    "dof_vel": 2,
    "des_dof_pos": 2,
    "des_dof_vel": 2,
    "des_dof_torque": 2,
}


class ContractViolation(ValueError):
    """A recording whose topics or columns cannot mean what their names state; the message gives what was expected and found."""


def bag_violation(path: str | Path, error: Exception) -> ContractViolation:
    """What is wrong with a bag, which is named once: most errors begin with it."""
    name, text = f"bag {Path(path)}", str(error)
    return ContractViolation(text if text.startswith(name) else f"{name}: {text}")


class HasJoints(Protocol):
    """An arm: names of joints, base to tip, and what else of its model moves (`arm.model.HeldJoint`)."""

    joints: tuple[str, ...]
    held: tuple


def load_log(path: str | Path, joints: Sequence[str] | HasJoints = JOINT_NAMES) -> Log:
    """A log of an arm's joints, or of these, from a rosbag2 folder or an .npz file (`load_npz`). Raises ContractViolation."""
    path = Path(path)
    if path.is_file() and path.suffix not in (".npz", ".mcap", ".db3"):
        raise ContractViolation(f"file {path}: expected a rosbag2 folder or an .npz file with {', '.join(NPZ_KEYS)}")
    return load_npz(path, joints) if path.suffix == ".npz" else load_bag(path, joints)


def _names(joints: Sequence[str] | HasJoints) -> tuple[str, ...]:
    return tuple(getattr(joints, "joints", joints))


def load_bag(path: str | Path, joints: Sequence[str] | HasJoints = JOINT_NAMES) -> Log:
    """The joints of a rosbag2 recording. Its torques are without gravity. Raises ContractViolation.

    A measured torque is the mean of the period that ends at its stamp, a command acts in the one that begins
    there: both belong to the middle of that period. Messages may name further joints, in any order. The Panda's come at the rate of
    the contract, another arm's at any of `RECORDINGS.rates`. The controller's law is replayed from the first `target_gains` on.
    """
    joints, held = _names(joints), getattr(joints, "held", ())
    is_panda = joints == JOINT_NAMES
    name = f"bag {Path(path)}"
    try:
        with Recording(path, required=("joint_states",)) as recording:
            raw = recording.rows("joint_states", "effort_command", "motor_states", "target_gains", *PHASE_TOPICS)
            gains = [
                (stamp, _gains(numbers, len(joints)))
                for stamp, numbers in recording.read("target_gains", lambda message: message.data)
            ]
            stamp, values = read_joint_states(name, raw["joint_states"], joints)
            _check_held(name, raw["joint_states"], held)
            commanded, answers = _if_of_joints(name, raw.get("effort_command"), joints)
            motor_stamp, motor = _if_of_joints(name, raw.get("motor_states"), joints)
            phases = read_phase_changes(name, raw)
            record = read_loop_record(recording, stamp, commanded)
    except BagError as error:
        raise bag_violation(path, error) from error
    _check_order(f"{name}: joint_states", stamp / SECOND)
    loop = find_loop_timing(record)
    position, velocity, effort = values.transpose(1, 0, 2)
    fresh = find_fresh_rows(position, velocity)
    commanded, answers = _answers_of(stamp[fresh], stamp[~fresh], commanded, answers)
    stamp, position, velocity, effort = (rows[fresh] for rows in (stamp, position, velocity, effort))
    try:
        _check_times(name, stamp / SECOND, PERIOD if is_panda else None)
    except ContractViolation as error:
        timing = " ".join(fault.sentence for fault in loop.faults)
        raise ContractViolation(f"{error}{_repeated(fresh)}{timing and f'. {timing}'}") from error
    time = (stamp - stamp[0]) / SECOND
    period = PERIOD if is_panda else float(np.median(np.diff(time)))
    return Log(
        Path(path).name,
        time,
        position,
        velocity,
        effort,
        time - period / 2,
        False,
        _commands(name, stamp, time, commanded, answers, gains, period),
        _motor(stamp, motor_stamp, motor),
        tuple(((at - stamp[0]) / SECOND, state) for at, state in phases),
        loop=loop,
    )


def _check_held(name: str, messages: TopicMessages, held: Sequence) -> None:
    """Raise ContractViolation where a joint that the model holds still is recorded elsewhere, and weighs."""
    moved = []
    for joint in held:
        away = float(np.abs(read_joint_positions(messages, joint.name) - joint.reference).max(initial=0.0))
        if away * joint.load > RECORDINGS.held_load:
            moved.append(f"{joint.name} (up to {away:.2g} rad or m)")
    if moved:
        raise ContractViolation(
            f"{name}: expected joints that are not named to stay where the model holds them, {', '.join(moved)} did not: "
            "name them as joints of the arm"
        )


def _if_of_joints(name: str, messages: TopicMessages | None, joints: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """`read_joint_states` of a topic that a recording may lack: nothing where its messages are of other joints."""
    if not has_joint(messages, joints):
        return read_joint_states(name, None, joints)
    return read_joint_states(name, messages, joints)


def _repeated(fresh: np.ndarray) -> str:
    count = int((~fresh).sum())
    return f" ({count} of {len(fresh)} rows repeat the one before them, while the arm moves)" if count else ""


def _gains(numbers: np.ndarray, joints: int) -> np.ndarray:
    """Rows stiffness and damping ratio (2, k)."""
    if len(numbers) != 2 * joints:
        raise ValueError(f"expected 2 times {joints} numbers, got {len(numbers)}")
    return np.asarray(numbers, dtype=float).reshape(2, joints)


def _answers_of(kept: np.ndarray, dropped: np.ndarray, commanded: np.ndarray, answers: np.ndarray):
    """Commands without those computed from a row which has been dropped."""
    mine = ~np.isin(commanded, np.setdiff1d(dropped, kept))
    return commanded[mine], answers[mine]


def _commands(name, stamp, time, commanded, answers, gains, period) -> Commands | None:
    if not len(commanded):
        return None
    _check_order(f"{name}: effort_command", commanded / SECOND)
    common, rows, answer = np.intersect1d(stamp, commanded, return_indices=True)
    if len(common) < (1 - RECORDINGS.loss) * len(commanded):
        raise ContractViolation(
            f"{name}: effort_command: expected the stamps of joint_states, "
            f"{len(commanded) - len(common)} of {len(commanded)} have others"
        )
    target, velocity, torque = answers[answer].transpose(1, 0, 2)
    stiffness, ratio = np.zeros_like(target), np.zeros_like(target)  # not known before the first gains
    for at, table in gains:
        after = common >= at
        stiffness[after], ratio[after] = table
    return Commands(
        rows,
        target,
        velocity,
        torque,
        time[rows] + period / 2,
        stiffness,
        damping(stiffness, ratio),
        has_law=bool((stiffness > 0).all(axis=1).mean() >= RECORDINGS.with_gains),
    )


def _motor(stamp, motor_stamp, motor) -> np.ndarray | None:
    """Motor angles at the stamps of the joint states, NaN where there is none."""
    if not len(motor_stamp):
        return None
    _, rows, found = np.intersect1d(stamp, motor_stamp, return_indices=True)
    angles = np.full((len(stamp), motor.shape[2]), np.nan)
    angles[rows] = motor[found, 0]
    return angles


def load_npz(path: str | Path, joints: Sequence[str] | HasJoints = JOINT_NAMES) -> Log:
    """Arrays of one of three kinds. Raises ContractViolation.

    Measured torque (libfranka's robot state): t_s (n,), q_rad, dq_rad_s, tau_J_Nm (n, k), torque with gravity;
    stamps may be a PC's and jitter. Motor current: current_A (n, k) in place of the torque, positive where it drives the joint
    forwards, and torque_per_ampere (k,) Nm/A at the joint where that is known. Targets and gains: time, dof_pos, dof_vel,
    des_dof_pos, des_dof_vel, des_dof_torque (n, k or more), kp, kd: the drive's own law kp e - kd dq is all the torque there
    is, gravity included. joint_names (k,), where given, are those of the arm in its order. Other arrays are
    passed over.
    """
    name, names = f"file {path}", _names(joints)
    joints, known = len(names), {*NPZ_KEYS, *CURRENT_KEYS, *PD_KEYS, "torque_per_ampere"}
    try:
        with np.load(path, allow_pickle=False) as file:
            found = file.files
            content = {key: np.asarray(file[key], dtype=float) for key in found if key in known}
            given = tuple(map(str, np.ravel(file["joint_names"]))) if "joint_names" in found else names
    except (OSError, ValueError) as error:
        raise ContractViolation(f"{name}: expected an .npz file of numbers, got: {error}") from error
    if given != names:
        raise ContractViolation(f"{name}: joint_names: expected {', '.join(names)}, got {', '.join(given)}")
    is_current = "current_A" in content and "tau_J_Nm" not in content
    keys = PD_KEYS if "des_dof_torque" in content else CURRENT_KEYS if is_current else NPZ_KEYS
    missing = [key for key in keys if key not in content]
    if missing:
        raise ContractViolation(
            f"{name}: expected {', '.join(keys)}; {', '.join(missing)} missing, found {', '.join(found) or 'nothing'}"
        )
    time = content[next(iter(keys))]
    for key, dimensions in keys.items():
        if keys is PD_KEYS and dimensions == 2 and content[key].ndim == 2:
            content[key] = content[key][:, :joints]
        shape = (time.size, joints)[:dimensions]
        if content[key].shape != shape:
            raise ContractViolation(f"{name}: {key}: expected shape {shape}, got {content[key].shape}")
        if not np.isfinite(content[key]).all():
            raise ContractViolation(f"{name}: {key}: expected finite numbers")
    position, velocity, torque = (content[key] for key in list(keys)[1:3] + list(keys)[-1:])
    _check_order(name, time)
    fresh = find_fresh_rows(position, velocity)
    time, position, velocity, torque = time[fresh], position[fresh], velocity[fresh], torque[fresh]
    _check_times(name, time, None)
    if is_current and "torque_per_ampere" in content:
        torque, is_current = torque * _per_ampere(name, content["torque_per_ampere"], joints), False
    return Log(Path(path).name, time - time[0], position, velocity, torque, time - time[0], True, is_current=is_current)


def _per_ampere(name: str, values: np.ndarray, joints: int) -> np.ndarray:
    if values.shape != (joints,) or not (np.isfinite(values) & (values > 0)).all():
        raise ContractViolation(
            f"{name}: torque_per_ampere: expected {joints} numbers above 0, got {np.array2string(values, threshold=8)}"
        )
    return values


def _check_order(name: str, time: np.ndarray) -> None:
    back = np.flatnonzero(np.diff(time) <= 0)
    if back.size:
        raise ContractViolation(
            f"{name}: expected stamps that increase, got {time[back[0]]:.6f} s followed by "
            f"{time[back[0] + 1]:.6f} s, and {back.size} such places in all"
        )


def _check_times(name: str, time: np.ndarray, period: float | None) -> None:
    """Stamps increase at the given period; without one, at a rate of `RECORDINGS.rates`."""
    if len(time) < 2:
        raise ContractViolation(f"{name}: expected joint states over time, got {len(time)}")
    _check_order(name, time)
    steps = np.diff(time)
    median = float(np.median(steps))
    if period is None:
        slowest, fastest = RECORDINGS.rates
        slack = 1 + RECORDINGS.period_tolerance
        if not 1 / fastest / slack < median < slack / slowest:
            raise ContractViolation(
                f"{name}: expected {slowest:g} to {fastest:g} rows a second, got {1 / median:.4g}: "
                "times must be in seconds"
            )
        return
    if abs(median / period - 1) > RECORDINGS.period_tolerance:
        raise ContractViolation(f"{name}: joint_states: expected {1 / period:.0f} Hz, got {1 / median:.4g} Hz")
    lost = int(np.round(steps / period - 1).clip(0).sum())
    if lost > RECORDINGS.loss * (len(time) + lost):
        raise ContractViolation(
            f"{name}: joint_states: expected at most {RECORDINGS.loss:.0%} missing, got {lost} of {len(time) + lost}"
        )
