"""Writing a run as a rosbag2 folder, with the topics that a recording of the suite on a real arm has.

Without ROS: messages are serialized by rosbags, those of 500 Hz once each, the numbers of the others being
put in their places.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from heapq import merge
from pathlib import Path

import numpy as np
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from np_blind.loop import Run, Targets
from np_control.safety import LIMITS
from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_description.phases import EXCITE, IDLE, PhaseState
from np_diagnosis.experiments.excitation import TICK_NS

TYPES = get_typestore(Stores.ROS2_JAZZY)
SECOND = 1_000_000_000
APPLIED_EVERY = 5  # periods
_JOINT_STATE = "sensor_msgs/msg/JointState"
_SAID = "diagnostic_msgs/msg/DiagnosticArray"
_STAMPED = {
    "joint_states": _JOINT_STATE,
    "motor_states": _JOINT_STATE,
    "effort_command": _JOINT_STATE,
    "applied_command": _JOINT_STATE,
    "episode/tick": _SAID,
    "episode/phase": _SAID,
    "joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
    "target_gains": "std_msgs/msg/Float64MultiArray",
}
_FOREVER = QosTime(2147483647, 4294967295)

Messages = Iterator[tuple[int, str, bytes]]


def write_bag(path: Path, run: Run, arm: int, targets: Targets, begin: int, information: Mapping) -> None:
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
    writer = Writer(path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
    writer.set_custom_data("run_info", json.dumps(dict(information), sort_keys=True))
    with writer:
        connections = {
            name: writer.add_connection(
                f"/{name}", kind, typestore=TYPES, offered_qos_profiles=[_qos(name == "episode/phase")]
            )
            for name, kind in _STAMPED.items()
        }
        for stamp, name, data in merge(*streams, key=lambda message: message[0]):
            writer.write(connections[name], stamp, data)


def _joint_states(topic: str, stamps: np.ndarray, names: Sequence[str], position, velocity, effort) -> Messages:
    """JointStates at the stamps (n,) ns, with arrays (n, len(names))."""
    marks = np.arange(1.0, 3 * len(names) + 1).reshape(3, -1)
    template = np.frombuffer(TYPES.serialize_cdr(_joint_state(0, names, *marks), _JOINT_STATE), np.uint8)
    frames = np.tile(template, (len(stamps), 1))
    frames[:, 4:8] = (stamps // SECOND).astype("<i4").view(np.uint8).reshape(-1, 4)
    frames[:, 8:12] = (stamps % SECOND).astype("<u4").view(np.uint8).reshape(-1, 4)
    for row, values in zip(marks, (position, velocity, effort)):
        at = template.tobytes().index(row.astype("<f8").tobytes())
        frames[:, at : at + 8 * len(names)] = np.ascontiguousarray(values, "<f8").view(np.uint8)
    for stamp, frame in zip(stamps.tolist(), frames):
        yield stamp, topic, frame.tobytes()


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
    kinds = TYPES.types
    pairs = [kinds["diagnostic_msgs/msg/KeyValue"](key=key, value=value) for key, value in phase.values.items()]
    status = kinds["diagnostic_msgs/msg/DiagnosticStatus"](
        level=0, name="episode", message=str(phase), hardware_id="", values=pairs
    )
    return TYPES.serialize_cdr(kinds[_SAID](header=_header(stamp), status=[status]), _SAID)


def _trajectory(stamp: int, segment) -> bytes:
    kinds = TYPES.types
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
    return TYPES.serialize_cdr(message, message.__msgtype__)


def _gains(gains: np.ndarray) -> bytes:
    kinds = TYPES.types
    dimension = kinds["std_msgs/msg/MultiArrayDimension"]
    layout = kinds["std_msgs/msg/MultiArrayLayout"](
        dim=[dimension(label="gain", size=2, stride=14), dimension(label="joint", size=7, stride=7)], data_offset=0
    )
    message = kinds["std_msgs/msg/Float64MultiArray"](layout=layout, data=gains.ravel())
    return TYPES.serialize_cdr(message, message.__msgtype__)


def _joint_state(stamp: int, names: Sequence[str], position, velocity, effort):
    return TYPES.types[_JOINT_STATE](
        header=_header(stamp), name=list(names), position=position, velocity=velocity, effort=effort
    )


def _header(stamp: int):
    time = TYPES.types["builtin_interfaces/msg/Time"](sec=stamp // SECOND, nanosec=stamp % SECOND)
    return TYPES.types["std_msgs/msg/Header"](stamp=time, frame_id="")


def _qos(latched: bool) -> Qos:
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if latched else 100,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=_FOREVER,
        lifespan=_FOREVER,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_FOREVER,
        avoid_ros_namespace_conventions=False,
    )
