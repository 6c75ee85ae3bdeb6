"""Writing a run as a rosbag2 folder, with the topics that a recording of the suite on a real arm has. Without ROS."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from heapq import merge
from pathlib import Path

import numpy as np
from sim2real.excitation.suite import TICK_NS

from np_blind.arm.loop import RecordedRun, Targets
from np_control.safety import LIMITS
from np_description.control_rate import SECOND
from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_description.phases import EXCITE, IDLE, PhaseState
from np_record.bag_writer import BagWriter
from np_record.bulk import serialize_joint_states
from np_record.cdr import TYPESTORE, serialize
from np_record.topics import BY_NAME

APPLIED_EVERY = 5  # periods
TOPICS = tuple(
    BY_NAME[name]
    for name in (
        "joint_states",
        "motor_states",
        "effort_command",
        "applied_command",
        "episode/tick",
        "episode/phase",
        "joint_trajectory",
        "target_gains",
    )
)

Messages = Iterator[tuple[int, str, bytes]]


def write_bag(path: Path, run: RecordedRun, arm: int, targets: Targets, begin: int, information: Mapping) -> None:
    """Write one arm's recording to the new folder `path`; begin: stamp, ns, of its first state."""
    count = len(targets)
    stamps = begin + LIMITS.period_ns * np.arange(count, dtype=np.int64)
    hands = np.zeros((count, len(STATE_NAMES) - len(JOINT_NAMES)))
    target, velocity = run.target[:, arm], run.target_velocity[:, arm]
    every = slice(None, None, APPLIED_EVERY)
    streams = [
        _joint_states(
            "joint_states",
            stamps,
            STATE_NAMES,
            *(np.hstack([part[:, arm], hands]) for part in (run.position, run.velocity, run.effort)),
        ),
        _joint_states(
            "motor_states",
            stamps,
            JOINT_NAMES,
            run.motor_position[:, arm],
            run.motor_velocity[:, arm],
            run.effort[:, arm],
        ),
        _events(targets, begin, begin + count * LIMITS.period_ns),
        _joint_states("effort_command", stamps, JOINT_NAMES, target, velocity, run.command[:, arm]),
        _joint_states(
            "applied_command", stamps[every], JOINT_NAMES, target[every], velocity[every], run.applied[every, arm]
        ),
    ]
    writer = BagWriter(path, information, TOPICS)
    try:
        for stamp, name, data in merge(*streams, key=lambda message: message[0]):
            writer.write(stamp, BY_NAME[name], data)
    finally:
        writer.close()


def _joint_states(topic: str, stamps: np.ndarray, names: Sequence[str], position, velocity, effort) -> Messages:
    """JointStates at the stamps (n,) ns, with arrays (n, len(names))."""
    frames = serialize_joint_states(stamps, names, position, velocity, effort)
    for stamp, frame in zip(stamps.tolist(), frames):
        yield stamp, topic, frame


def _events(targets: Targets, begin: int, end: int) -> Messages:
    """Ticks, and each segment's phase, gains and trajectory."""
    changes = {begin + start: segment for start, segment in zip(targets.starts, targets.plan)}
    phase = PhaseState(IDLE)
    for stamp in range(-(-begin // TICK_NS) * TICK_NS, end, TICK_NS):
        segment = changes.get(stamp)
        if segment is not None:
            phase = PhaseState(EXCITE, experiment=segment.name)
            yield stamp, "episode/phase", _said(0, phase)
            yield stamp, "joint_trajectory", _trajectory(stamp, segment)
        yield stamp, "episode/tick", _said(stamp, phase)
        if segment is not None:
            yield stamp, "target_gains", _gains(segment.gains)


def _said(stamp: int, phase: PhaseState) -> bytes:
    kinds = TYPESTORE.types
    pairs = [kinds["diagnostic_msgs/msg/KeyValue"](key=key, value=value) for key, value in phase.values.items()]
    status = kinds["diagnostic_msgs/msg/DiagnosticStatus"](
        level=0, name="episode", message=str(phase), hardware_id="", values=pairs
    )
    return serialize(kinds["diagnostic_msgs/msg/DiagnosticArray"](header=_header(stamp), status=[status]))


def _trajectory(stamp: int, segment) -> bytes:
    kinds = TYPESTORE.types
    points, zeros = [], np.zeros(len(JOINT_NAMES))
    for time, position, velocity in zip(segment.times.tolist(), segment.positions, segment.velocities):
        seconds, rest = divmod(round(time * SECOND), SECOND)
        duration = kinds["builtin_interfaces/msg/Duration"](sec=seconds, nanosec=rest)
        points.append(
            kinds["trajectory_msgs/msg/JointTrajectoryPoint"](
                positions=position, velocities=velocity, accelerations=zeros, effort=zeros, time_from_start=duration
            )
        )
    message = kinds["trajectory_msgs/msg/JointTrajectory"](
        header=_header(stamp), joint_names=list(JOINT_NAMES), points=points
    )
    return serialize(message)


def _gains(gains: np.ndarray) -> bytes:
    kinds = TYPESTORE.types
    dimension = kinds["std_msgs/msg/MultiArrayDimension"]
    layout = kinds["std_msgs/msg/MultiArrayLayout"](
        dim=[dimension(label="gain", size=2, stride=14), dimension(label="joint", size=7, stride=7)], data_offset=0
    )
    message = kinds["std_msgs/msg/Float64MultiArray"](layout=layout, data=gains.ravel())
    return serialize(message)


def _header(stamp: int):
    time = TYPESTORE.types["builtin_interfaces/msg/Time"](sec=stamp // SECOND, nanosec=stamp % SECOND)
    return TYPESTORE.types["std_msgs/msg/Header"](stamp=time, frame_id="")
