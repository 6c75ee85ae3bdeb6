"""What is measured while an arm behind the driver moves: cycles, tracking error, cost."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from cpu_shares import CpuShares, children
from moving_arm import MovingArm
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from np_control.kinematics import forward_kinematics
from np_description.message_arrays import joint_state_arrays, stamp_nanoseconds
from np_description.panda import JOINT_NAMES, NOMINAL
from np_evaluation.conformance.commands import PERIOD
from np_ros import qos

STATISTICS = ("cycles", "cycle_rate_hz", "cycle_p50_ms", "cycle_p99_ms", "cycle_max_ms")
COUNTS = ("lost_cycles", "commands")


class Measurement:
    """Everything from its construction to `row`: the arm is held anew first, where the driver's account of
    its cycles begins."""

    def __init__(self, arm: MovingArm):
        self._arm = arm
        self._load = os.getloadavg()[0]
        arm.harness.wait(lambda: len(arm.harness.states) > 200, "states")
        self._offset = clock_offset(arm)
        arm.deafen()
        arm.hold_anew()
        self._before, self._robot = self._counts(), arm.robot.request("forget")
        graph = arm.harness.graph
        (hand,) = children(graph.pid("franka_driver"))
        self._shares = CpuShares(
            {
                "simulated robot": arm.robot.process.pid,
                "this report": os.getpid(),
                **{name: graph.pid(name) for name in graph.names},
                "hand's client": hand,
            }
        )

    def now(self) -> int:
        """Stamp ns of the newest state, or of one a few before it."""
        return (self._offset + round(1e9 * self._arm.state()["time"])) // PERIOD * PERIOD

    def row(self, raw: list[bytes]) -> dict[str, object]:
        """The figures. raw: the effort commands since then, as `overheard` has them."""
        shares, stolen = self._shares.shares(), self._shares.stolen()
        arm = self._arm
        arm.harness.probe.idle_for(1.1)  # for the driver's account of the last second
        status, counts, robot = arm.harness.status, self._counts(), arm.robot.request("state")
        said = {name: float(status[name]) for name in STATISTICS}
        commanded = robot["commanded"] - self._robot["commanded"]
        accepted = counts["commands"] - self._before["commands"]
        return {
            "load_before": round(self._load, 2),
            "stolen": stolen,
            "state": status["state"],
            "message": arm.harness.message,
            **said,
            "lost_cycles": counts["lost_cycles"] - self._before["lost_cycles"],
            "commands_per_1000": round(1e3 * accepted / said["cycles"]),
            "unanswered_per_1000": round(
                1e3 * (robot["unanswered"] - self._robot["unanswered"]) / max(commanded, 1), 2
            ),
            "robot_pause_ms": round(1e3 * robot["pause"], 1),
            **following(arm.trace(), raw, self._offset),
            "shares": shares,
        }

    def _counts(self) -> dict[str, int]:
        arm = self._arm
        arm.harness.wait(lambda: all(name in arm.harness.status for name in COUNTS), "the driver's account")
        return {name: int(arm.harness.status[name]) for name in COUNTS}


@contextmanager
def overheard(arm: MovingArm) -> Iterator[list[bytes]]:
    """All effort commands meanwhile, as bytes: the joint target of every state that was answered."""
    node, raw = arm.harness.probe.node, []
    subscription = node.create_subscription(JointState, "effort_command", raw.append, qos.RECORDER, raw=True)
    yield raw
    node.destroy_subscription(subscription)


def clock_offset(arm: MovingArm) -> int:
    """ns from the robot's clock, as it counts its cycles, to the driver's stamps, by states that both
    know.
    """
    trace = arm.trace()
    told = [row.tobytes() for row in trace[:, 1:8].astype(np.float32)]  # as the protocol carries them
    seen = Counter(told)
    times = {q: round(1000 * time) * 1_000_000 for q, time in zip(told, trace[:, 0]) if seen[q] == 1}
    stamps = {
        np.float32(state.position[:7]).tobytes(): stamp_nanoseconds(state.header.stamp) for state in arm.harness.states
    }
    # A state of an odd millisecond is published under the even one before it.
    return max(stamps[q] - times[q] for q in stamps if q in times)


def following(trace: np.ndarray, raw: list[bytes], offset: int) -> dict[str, float]:
    """The joint targets of `raw` against what the robot itself knows of its joints at the time."""
    commands = [deserialize_message(data, JointState) for data in raw]
    stamps = np.array([stamp_nanoseconds(command.header.stamp) for command in commands])
    targets = np.array([joint_state_arrays(command, JOINT_NAMES)[0] for command in commands])
    at = (stamps - offset) * 1e-9
    q = np.stack([np.interp(at, trace[:, 0], column) for column in trace[:, 1:8].T], axis=1)
    error, hand = np.abs(targets - q), forward_kinematics(targets)[0] - forward_kinematics(q)[0]
    distance = 1e3 * np.linalg.norm(hand, axis=1)
    return {
        "compared": len(commands),
        "joint_rms_rad": round(float(np.sqrt((error**2).mean())), 5),
        "joint_max_rad": round(float(error.max()), 5),
        "hand_rms_mm": round(float(np.sqrt((distance**2).mean())), 2),
        "hand_max_mm": round(float(distance.max()), 2),
        "peak_speed_share": round(float(np.abs(trace[:, 8:15] / NOMINAL.velocity_limit).max()), 3),
    }
