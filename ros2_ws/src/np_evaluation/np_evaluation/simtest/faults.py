"""The faults of a run: how they are drawn from a seed, and how they corrupt messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

from np_record.nodes.recorder_node import find_message_class
from np_record.topics import BY_NAME

NODES = ("sim_bridge", "joint_impedance", "keypoint_oracle", "pre_contact", "approach", "post_contact", "episode")
STREAMS = ("joint_states", "effort_command", "keypoints", "object_pose", "target_pose", "target_gains", "episode/tick")
EVENTS = ("joint_trajectory", "gripper_command", "pre_contact_pose", "goal_pose", "goal_keypoints", "episode/phase")
CORRUPTIBLE = (*STREAMS[:-1], "joint_trajectory", "gripper_command", "pre_contact_pose", "goal_pose")


@dataclass(frozen=True)
class InjectedFault:
    """One fault: `kind` at `at` s of the run, on a node or topic, for `seconds`; the unit of `size` depends on the kind."""

    kind: str
    at: float
    target: str = ""
    seconds: float = 0.0
    size: float = 0.0

    def __str__(self) -> str:
        size = f" {self.size:.3g}" if self.size else ""
        lasts = f" for {self.seconds:.3f} s" if self.seconds else ""
        return f"{self.at:.3f} s: {self.kind} {self.target}{size}{lasts}"


# Per kind: name, weight, targets, seconds (from, to), size (from, to).
_KINDS = (
    ("crash", 4, NODES, (0.2, 4.0), (0, 0)),
    ("freeze", 3, NODES, (0.02, 3.0), (0, 0)),
    ("stop", 2, NODES, (0.2, 2.0), (0, 0)),
    ("late_start", 1, NODES, (0.5, 3.0), (0, 0)),
    ("delay", 3, STREAMS + EVENTS, (0.1, 2.0), (1e-3, 0.5)),
    ("loss", 3, STREAMS, (0.1, 2.0), (0.1, 1.0)),
    ("duplicates", 2, STREAMS + EVENTS, (0.5, 4.0), (0.1, 1.0)),
    ("nan", 3, CORRUPTIBLE, (0.02, 1.5), (0, 0)),
    ("wrong", 2, CORRUPTIBLE, (0.02, 1.5), (0.1, 10.0)),
    ("silent_camera", 2, ("keypoints",), (0.2, 4.0), (0, 0)),
    ("frozen_camera", 2, ("keypoints",), (0.2, 4.0), (0, 0)),
    ("clock_jump", 2, ("",), (0, 0), (-30.0, 30.0)),
    ("sensor_nan", 1, ("",), (0.002, 0.05), (0, 0)),
    ("sensor_jump", 1, ("",), (0.002, 0.05), (-1.0, 1.0)),
    ("push", 2, ("",), (0.05, 0.5), (5.0, 60.0)),
    ("request", 3, ("sim_bridge/stop", "sim_bridge/reset", "episode/stop", "sim_bridge/recover"), (0, 0), (0, 0)),
    ("pause", 1, ("",), (0.1, 1.0), (0, 0)),
    ("disk_full", 1, ("recorder",), (0, 0), (1e5, 4e6)),
    ("crash_recorder", 1, ("recorder",), (0.2, 2.0), (0, 0)),
)


def draw(rng: np.random.Generator, horizon: float, recorded: bool) -> list[InjectedFault]:
    """Draw one to six faults within `horizon` s; those of the recorder only if a run is recorded."""
    kinds = [row for row in _KINDS if recorded or row[2] != ("recorder",)]
    weights = np.array([row[1] for row in kinds], float)
    faults = []
    for _ in range(int(rng.integers(1, 7))):
        kind, _, targets, seconds, size = kinds[rng.choice(len(kinds), p=weights / weights.sum())]
        fault = InjectedFault(kind, float(rng.uniform(0.8, horizon)), str(rng.choice(targets)), _draw(rng, *seconds))
        faults.append(replace(fault, size=_draw(rng, *size), at=0.0 if kind == "late_start" else fault.at))
    return sorted(faults, key=lambda fault: fault.at)


def _draw(rng: np.random.Generator, low: float, high: float) -> float:
    if low <= 0:
        return float(rng.uniform(low, high))
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def make_corrupter(topic: str, kind: str, size: float) -> Callable[[bytes], bytes]:
    """Make a function that sets a value of a topic's messages to NaN (`nan`) or adds `size` to it (`wrong`)."""
    message_type, value = find_message_class(BY_NAME[topic].type), float("nan")

    def change(data: bytes) -> bytes:
        message = deserialize_message(data, message_type)
        _corrupt(message, lambda old: value if kind == "nan" else old + size)
        return serialize_message(message)

    return change


def _corrupt(message, corrupt: Callable[[float], float]) -> None:
    """Change the first number of a message's content, of a trajectory that of its last point."""
    name = type(message).__name__
    if name == "JointState":
        message.position[0] = corrupt(message.position[0])
    elif name == "PoseStamped":
        message.pose.position.x = corrupt(message.pose.position.x)
    elif name == "PointCloud2":
        points = np.frombuffer(bytes(message.data), "<f4").copy()
        points[0] = corrupt(float(points[0]))
        message.data = points.tobytes()
    elif name == "Float64MultiArray":
        message.data[0] = corrupt(message.data[0])
    elif name == "Float64":
        message.data = corrupt(message.data)
    elif message.points:
        message.points[-1].positions[0] = corrupt(message.points[-1].positions[0])


class FrozenCamera:
    """Corrupts keypoints as a frozen camera does: the first content repeats, the stamps advance."""

    def __init__(self) -> None:
        self._content: bytes | None = None

    def __call__(self, data: bytes) -> bytes:
        message = deserialize_message(data, find_message_class(BY_NAME["keypoints"].type))
        self._content = self._content or bytes(message.data)
        message.data = self._content
        return serialize_message(message)
