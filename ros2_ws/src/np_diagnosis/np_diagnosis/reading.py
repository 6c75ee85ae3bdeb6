"""Recordings to logs. Fails closed: what breaks the contract of docs/graph.md is no evidence of friction."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from np_bringup.bag import BagError, Recording
from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_ros.messages import BadMessage, joint_state_arrays, stamp_nanoseconds

from np_diagnosis.signals import Commands, Log

PERIOD = 0.002  # s between joint states
PERIOD_TOLERANCE = 0.05
LARGEST_LOSS = 0.02  # share of joint states that may be missing
SECOND = 1e9
NPZ_KEYS = {"t_s": 1, "q_rad": 2, "dq_rad_s": 2, "tau_J_Nm": 2}  # name: dimensions


class ContractViolation(ValueError):
    """A recording that cannot mean what its topics or columns claim; says what was expected and found."""


def read(path: str | Path) -> Log:
    """A log from a rosbag2 folder, or from an .npz file (`read_npz`). Raises ContractViolation."""
    return read_npz(path) if Path(path).suffix == ".npz" else read_bag(path)


def read_bag(path: str | Path) -> Log:
    """The joints of a rosbag2 recording. Its torques are without gravity. Raises ContractViolation.

    A measured torque is the mean of the period that ends at its stamp, a command acts in the one that begins
    there: both belong to the middle of that period.
    """
    name = f"bag {path}"
    try:
        with Recording(path, required=("joint_states",)) as recording:
            states = _joint_states(recording, "joint_states", STATE_NAMES)
            commands = _joint_states(recording, "effort_command", JOINT_NAMES)
            has_own_gains = not recording.counts.get("target_gains")
    except (BagError, BadMessage) as error:
        raise ContractViolation(str(error)) from error
    stamp, values = states
    _check_times(name, stamp / SECOND, PERIOD)
    time = (stamp - stamp[0]) / SECOND
    joints = values[:, :, : len(JOINT_NAMES)]
    answers = None
    if len(commands[0]):
        _check_order(f"{name}: effort_command", commands[0] / SECOND)
        common, rows, answer = np.intersect1d(stamp, commands[0], return_indices=True)
        if len(common) < (1 - LARGEST_LOSS) * len(commands[0]):
            raise ContractViolation(
                f"{name}: effort_command: expected the stamps of joint_states, "
                f"{len(commands[0]) - len(common)} of {len(commands[0])} have others"
            )
        target, velocity, torque = commands[1][answer].transpose(1, 0, 2)
        answers = Commands(rows, target, velocity, torque, time[rows] + PERIOD / 2, has_own_gains)
    return Log(
        Path(path).name, time, joints[:, 0], joints[:, 1], joints[:, 2], time - PERIOD / 2, False, answers
    )


def read_npz(path: str | Path) -> Log:
    """Arrays t_s (n,), q_rad, dq_rad_s, tau_J_Nm (n, 7), torque with gravity. Raises ContractViolation.

    These are the names of libfranka's robot state; stamps may be a PC's and jitter.
    """
    name = f"file {path}"
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {key: np.asarray(file[key], dtype=float) for key in NPZ_KEYS if key in file.files}
            others = sorted(set(file.files) - set(NPZ_KEYS))
    except (OSError, ValueError) as error:
        raise ContractViolation(f"{name}: expected an .npz file of numbers, got: {error}") from error
    missing = [key for key in NPZ_KEYS if key not in found]
    if missing:
        raise ContractViolation(
            f"{name}: expected {', '.join(NPZ_KEYS)}; {', '.join(missing)} missing, "
            f"found {', '.join([*found, *others]) or 'nothing'}"
        )
    time = found["t_s"]
    for key, dimensions in NPZ_KEYS.items():
        shape = (time.size, len(JOINT_NAMES))[:dimensions]
        if found[key].shape != shape:
            raise ContractViolation(f"{name}: {key}: expected shape {shape}, got {found[key].shape}")
        if not np.isfinite(found[key]).all():
            raise ContractViolation(f"{name}: {key}: expected finite numbers")
    _check_times(name, time, None)
    return Log(
        Path(path).name,
        time - time[0],
        found["q_rad"],
        found["dq_rad_s"],
        found["tau_J_Nm"],
        time - time[0],
        True,
    )


def _joint_states(recording: Recording, topic: str, names) -> tuple[np.ndarray, np.ndarray]:
    """(stamps (n,) ns, values (n, 3, joints): position, velocity, effort) of a topic."""
    stamps, values = [], []
    for message in recording.messages(topic):
        decoded = message.decode()
        try:
            stamps.append(stamp_nanoseconds(decoded.header.stamp))
            values.append(joint_state_arrays(decoded, names))
        except BadMessage as error:
            raise BadMessage(
                error.kind, f"bag {recording.path}: {topic} at {message.stamp} ns: {error}"
            ) from error
    return np.array(stamps, dtype=np.int64), np.array(values, dtype=float).reshape(len(values), 3, len(names))


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
        if not 1e-4 < median < 1e-2:
            raise ContractViolation(
                f"{name}: expected 100 to 10000 rows a second, got {1 / median:.4g}: "
                "times must be in seconds"
            )
        return
    if abs(median / period - 1) > PERIOD_TOLERANCE:
        raise ContractViolation(
            f"{name}: joint_states: expected {1 / period:.0f} Hz, got {1 / median:.4g} Hz"
        )
    lost = int(np.round(steps / period - 1).clip(0).sum())
    if lost > LARGEST_LOSS * (len(time) + lost):
        raise ContractViolation(
            f"{name}: joint_states: expected at most {LARGEST_LOSS:.0%} missing, got "
            f"{lost} of {len(time) + lost}"
        )
