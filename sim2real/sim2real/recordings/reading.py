"""Recordings to logs. Fails closed: what breaks the contract of docs/reference/graph.md is no evidence of friction.

Messages are read in bulk from their bytes (np_record.bulk), three minutes at 500 Hz in a quarter of a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from np_control.impedance import STIFFNESS_MAX, damping
from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_record.bag import BagError, Recording
from np_record.bulk import BulkError, decode_message, joint_states
from np_record.recorded_phases import PHASE_TOPICS, phase_changes
from sim2real.recordings.signals import Commands, Log
from sim2real.thresholds import THRESHOLDS

RECORDINGS = THRESHOLDS.recordings

PERIOD = 0.002  # s between joint states
SECOND = 1e9
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
    """A recording that cannot mean what its topics or columns claim; says what was expected and found."""


def bag_violation(path: str | Path, error: Exception) -> ContractViolation:
    """What is wrong with a bag, which is named once: most errors begin with it."""
    name, said = f"bag {Path(path)}", str(error)
    return ContractViolation(said if said.startswith(name) else f"{name}: {said}")


class HasJoints(Protocol):
    """An arm: anything with names of joints, base to tip."""

    joints: tuple[str, ...]


def load_log(path: str | Path, joints: Sequence[str] | HasJoints = JOINT_NAMES) -> Log:
    """A log of an arm's joints, or of these, from a rosbag2 folder or an .npz file (`load_npz`). Raises ContractViolation."""
    return load_npz(path, joints) if Path(path).suffix == ".npz" else load_bag(path, joints)


def _names(joints: Sequence[str] | HasJoints) -> tuple[str, ...]:
    return tuple(getattr(joints, "joints", joints))


def load_bag(path: str | Path, joints: Sequence[str] | HasJoints = JOINT_NAMES) -> Log:
    """The joints of a rosbag2 recording. Its torques are without gravity. Raises ContractViolation.

    A measured torque is the mean of the period that ends at its stamp, a command acts in the one that begins
    there: both belong to the middle of that period. The Panda's topics keep names, order and rate of the contract; another
    arm's messages may name further joints, in any order, at any rate of `RECORDINGS.rates`. Its controller's law is replayed
    where `target_gains` are recorded.
    """
    joints = _names(joints)
    is_panda = joints == JOINT_NAMES
    name = f"bag {Path(path)}"
    try:
        with Recording(path, required=("joint_states",)) as recording:
            raw = recording.rows("joint_states", "effort_command", "motor_states", "target_gains", *PHASE_TOPICS)
            if is_panda:
                stamp, values = joint_states(name, "joint_states", raw["joint_states"], STATE_NAMES)
                commanded, answers = joint_states(name, "effort_command", raw.get("effort_command"), JOINT_NAMES)
            else:
                stamp, values = _of_joints(name, "joint_states", raw["joint_states"], joints)
                commanded, answers = _of_joints(name, "effort_command", raw.get("effort_command"), joints)
            motor_stamp, motor = joint_states(name, "motor_states", raw.get("motor_states"), None)
            gains = [_gains(name, m, len(joints)) for m in raw.get("target_gains", ())]
            phases = phase_changes(name, raw)
    except (BagError, BulkError) as error:
        raise bag_violation(path, error) from error
    _check_times(name, stamp / SECOND, PERIOD if is_panda else None)
    time = (stamp - stamp[0]) / SECOND
    period = PERIOD if is_panda else float(np.median(np.diff(time)))
    if is_panda:
        gains = [(-1, np.stack([STIFFNESS_MAX, np.ones_like(STIFFNESS_MAX)])), *gains]
    position, velocity, effort = values[:, :, : len(joints)].transpose(1, 0, 2)
    return Log(
        Path(path).name,
        time,
        position,
        velocity,
        effort,
        time - period / 2,
        False,
        _commands(name, stamp, time, commanded, answers, gains, period),
        _motor(name, stamp, motor_stamp, motor, len(joints)),
        tuple(((at - stamp[0]) / SECOND, state) for at, state in phases),
    )


def _of_joints(name: str, topic: str, messages, joints: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """`joint_states` of these joints, whatever others the messages name, and in whatever order."""
    stamp, values = joint_states(name, topic, messages, None)
    if not messages:
        return stamp, np.zeros((0, 3, len(joints)))
    named = list(decode_message(f"{name}: {topic}", messages[0]).name)
    missing = [joint for joint in joints if joint not in named]
    if missing:
        raise ContractViolation(f"{name}: {topic}: expected joints {', '.join(missing)}, got {', '.join(named)}")
    return stamp, values[:, :, [named.index(joint) for joint in joints]]


def _gains(name: str, message, joints: int) -> tuple[int, np.ndarray]:
    """(stamp ns, rows stiffness and damping ratio (2, k))."""
    numbers = np.asarray(decode_message(f"{name}: target_gains", message).data, dtype=float)
    if numbers.size != 2 * joints:
        raise ContractViolation(f"{name}: target_gains: expected 2 times {joints} numbers, got {numbers.size}")
    return message.stamp, numbers.reshape(2, joints)


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
    stiffness, ratio = np.zeros_like(target), np.zeros_like(target)
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
        has_law=bool((stiffness > 0).all()),
    )


def _motor(name, stamp, motor_stamp, motor, joints) -> np.ndarray | None:
    """Motor angles at the stamps of the joint states, NaN where there is none."""
    if not len(motor_stamp):
        return None
    if motor.shape[2] < joints:
        raise ContractViolation(f"{name}: motor_states: expected {joints} joints")
    _, rows, found = np.intersect1d(stamp, motor_stamp, return_indices=True)
    angles = np.full((len(stamp), joints), np.nan)
    angles[rows] = motor[found, 0, :joints]
    return angles


def load_npz(path: str | Path, joints: Sequence[str] | HasJoints = JOINT_NAMES) -> Log:
    """Arrays of one of three kinds. Raises ContractViolation.

    Measured torque (libfranka's robot state): t_s (n,), q_rad, dq_rad_s, tau_J_Nm (n, k), torque with gravity;
    stamps may be a PC's and jitter. Motor current: current_A (n, k) in place of the torque, positive where it drives the joint
    forwards, and torque_per_ampere (k,) Nm/A at the joint where that is known. Targets and gains: time, dof_pos, dof_vel,
    des_dof_pos, des_dof_vel, des_dof_torque (n, k or more), kp, kd: the drive's own law kp e - kd dq is all the torque there
    is, gravity included.
    """
    name, joints = f"file {path}", len(_names(joints))
    try:
        with np.load(path, allow_pickle=False) as file:
            content = {key: np.asarray(file[key], dtype=float) for key in file.files}
    except (OSError, ValueError) as error:
        raise ContractViolation(f"{name}: expected an .npz file of numbers, got: {error}") from error
    is_current = "current_A" in content and "tau_J_Nm" not in content
    keys = PD_KEYS if "des_dof_torque" in content else CURRENT_KEYS if is_current else NPZ_KEYS
    missing = [key for key in keys if key not in content]
    if missing:
        raise ContractViolation(
            f"{name}: expected {', '.join(keys)}; {', '.join(missing)} missing, found {', '.join(content) or 'nothing'}"
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
    _check_times(name, time, None)
    position, velocity, torque = (content[key] for key in list(keys)[1:3] + list(keys)[-1:])
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
