"""Recordings to logs. Fails closed: what breaks the contract of docs/reference/graph.md is no evidence of friction.

Messages are read in bulk from their bytes (np_record.bulk), three minutes at 500 Hz in a quarter of a second.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from np_control.impedance import STIFFNESS_MAX, damping
from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_diagnosis.recordings.signals import Commands, Log
from np_diagnosis.thresholds import THRESHOLDS
from np_record.bag import BagError, Recording
from np_record.bulk import BulkError, decoded, joint_states
from np_record.recorded_phases import PHASE_TOPICS, phase_changes

RECORDINGS = THRESHOLDS.recordings

PERIOD = 0.002  # s between joint states
SECOND = 1e9
NPZ_KEYS = {"t_s": 1, "q_rad": 2, "dq_rad_s": 2, "tau_J_Nm": 2}  # name: dimensions
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


def read(path: str | Path, joints: int = len(JOINT_NAMES)) -> Log:
    """A log from a rosbag2 folder, or from an .npz file (`read_npz`). Raises ContractViolation."""
    return read_npz(path, joints) if Path(path).suffix == ".npz" else read_bag(path)


def read_bag(path: str | Path) -> Log:
    """The joints of a rosbag2 recording. Its torques are without gravity. Raises ContractViolation.

    A measured torque is the mean of the period that ends at its stamp, a command acts in the one that begins
    there: both belong to the middle of that period.
    """
    name = f"bag {path}"
    try:
        with Recording(path, required=("joint_states",)) as recording:
            raw = recording.rows("joint_states", "effort_command", "motor_states", "target_gains", *PHASE_TOPICS)
            stamp, values = joint_states(name, "joint_states", raw["joint_states"], STATE_NAMES)
            commanded, answers = joint_states(name, "effort_command", raw.get("effort_command"), JOINT_NAMES)
            motor_stamp, motor = joint_states(name, "motor_states", raw.get("motor_states"), None)
            gains = [
                (m.stamp, np.reshape(decoded(f"{name}: target_gains", m).data, (2, len(JOINT_NAMES))))
                for m in raw.get("target_gains", ())
            ]
            phases = phase_changes(name, raw)
    except (BagError, BulkError) as error:
        raise ContractViolation(str(error)) from error
    _check_times(name, stamp / SECOND, PERIOD)
    time = (stamp - stamp[0]) / SECOND
    joints = values[:, :, : len(JOINT_NAMES)]
    return Log(
        Path(path).name,
        time,
        joints[:, 0],
        joints[:, 1],
        joints[:, 2],
        time - PERIOD / 2,
        False,
        _commands(name, stamp, time, commanded, answers, gains),
        _motor(name, stamp, motor_stamp, motor),
        tuple(((at - stamp[0]) / SECOND, state) for at, state in phases),
    )


def _commands(name, stamp, time, commanded, answers, gains) -> Commands | None:
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
    stiffness = np.tile(STIFFNESS_MAX, (len(rows), 1))
    ratio = np.ones_like(stiffness)
    for at, table in gains:
        after = common >= at
        stiffness[after], ratio[after] = table
    return Commands(rows, target, velocity, torque, time[rows] + PERIOD / 2, stiffness, damping(stiffness, ratio))


def _motor(name, stamp, motor_stamp, motor) -> np.ndarray | None:
    """Motor angles at the stamps of the joint states, NaN where there is none."""
    if not len(motor_stamp):
        return None
    if motor.shape[2] < len(JOINT_NAMES):
        raise ContractViolation(f"{name}: motor_states: expected {len(JOINT_NAMES)} joints")
    _, rows, found = np.intersect1d(stamp, motor_stamp, return_indices=True)
    angles = np.full((len(stamp), len(JOINT_NAMES)), np.nan)
    angles[rows] = motor[found, 0, : len(JOINT_NAMES)]
    return angles


def read_npz(path: str | Path, joints: int = len(JOINT_NAMES)) -> Log:
    """Arrays of one of two kinds. Raises ContractViolation.

    Measured torque (libfranka's robot state): t_s (n,), q_rad, dq_rad_s, tau_J_Nm (n, k), torque with gravity;
    stamps may be a PC's and jitter. Targets and gains: time, dof_pos, dof_vel, des_dof_pos, des_dof_vel,
    des_dof_torque (n, k or more), kp, kd: the drive's own law kp e - kd dq is all the torque there is, gravity
    included.
    """
    name = f"file {path}"
    try:
        with np.load(path, allow_pickle=False) as file:
            content = {key: np.asarray(file[key], dtype=float) for key in file.files}
    except (OSError, ValueError) as error:
        raise ContractViolation(f"{name}: expected an .npz file of numbers, got: {error}") from error
    keys = PD_KEYS if "des_dof_torque" in content else NPZ_KEYS
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
    return Log(Path(path).name, time - time[0], position, velocity, torque, time - time[0], True)


def _check_order(name: str, time: np.ndarray) -> None:
    back = np.flatnonzero(np.diff(time) <= 0)
    if back.size:
        raise ContractViolation(
            f"{name}: expected stamps that increase, got {time[back[0]]:.6f} s followed by "
            f"{time[back[0] + 1]:.6f} s, and {back.size} such places in all"
        )


def _check_times(name: str, time: np.ndarray, period: float | None) -> None:
    """Stamps increase at the given period, or at least at 100 Hz."""
    if len(time) < 2:
        raise ContractViolation(f"{name}: expected joint states over time, got {len(time)}")
    _check_order(name, time)
    steps = np.diff(time)
    median = float(np.median(steps))
    if period is None:
        slowest, fastest = RECORDINGS.rates
        if not 1 / fastest < median < 1 / slowest:
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
