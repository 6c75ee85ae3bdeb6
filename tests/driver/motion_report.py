"""How well an arm behind the driver follows: a minute of impedance tracking, and the approach of a card
episode.
"""

from __future__ import annotations

from collections import Counter
from contextlib import contextmanager

import numpy as np
from geometry_msgs.msg import PoseStamped
from moving_arm import MovingArm
from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA
from np_description.domains import find_domain, sample_task
from np_description.keypoints import box_keypoints
from np_description.panda import BASE_FRAME, JOINT_NAMES, NOMINAL
from np_description.rotations import quaternion_from_matrix, rotation_angle
from np_description.scene import CAMERA_NAME
from np_ros import qos
from np_ros.messages import (
    joint_state_arrays,
    keypoints_message,
    pose_arrays,
    pose_message,
    stamp_nanoseconds,
    trajectory_arrays,
    trajectory_message,
)
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

PIECE = 10.0  # s of one trajectory
AMPLITUDE = np.array([0.35, 0.25, 0.3, 0.3, 0.35, 0.3, 0.5])  # rad
STATISTICS = ("cycles", "cycle_rate_hz", "cycle_p50_ms", "cycle_p99_ms", "cycle_max_ms", "lost_cycles")


def waves(begin: np.ndarray, number: int, step: float = 0.05) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A trajectory of PIECE s about `begin` (7,) rad, at rest at both ends: two waves a joint, other ones
    each time.
    """
    times = np.linspace(0, PIECE, round(PIECE / step) + 1)[:, None]
    rng = np.random.default_rng(number)
    window, slope = np.sin(np.pi * times / PIECE) ** 2, np.pi / PIECE * np.sin(2 * np.pi * times / PIECE)
    shape, rate = np.zeros((len(times), 7)), np.zeros((len(times), 7))
    for frequency in rng.uniform(0.1, 0.4, (2, 7)):
        phase = 2 * np.pi * frequency * times + rng.uniform(0, 2 * np.pi, 7)
        shape += 0.5 * np.sin(phase)
        rate += np.pi * frequency * np.cos(phase)
    velocities = AMPLITUDE * (window * rate + slope * shape)
    velocities[[0, -1]] = 0.0
    return times[:, 0], begin + AMPLITUDE * window * shape, velocities


@contextmanager
def overheard(arm: MovingArm):
    """All effort commands meanwhile, as bytes: the joint target of every state that was answered."""
    node, raw = arm.harness.probe.node, []
    subscription = node.create_subscription(JointState, "effort_command", raw.append, qos.RECORDER, raw=True)
    yield raw
    node.destroy_subscription(subscription)


def deafen(arm: MovingArm) -> None:
    """Listen to states no longer: reading 500 a second takes time from what is measured."""
    node = arm.harness.probe.node
    for subscription in list(node.subscriptions):
        if subscription.topic_name == "/joint_states":
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
        np.float32(state.position[:7]).tobytes(): stamp_nanoseconds(state.header.stamp)
        for state in arm.harness.states
    }
    # A state of an odd millisecond is published under the even one before it.
    return max(stamps[q] - times[q] for q in stamps if q in times)


def tracking(arm: MovingArm, raw: list[bytes], offset: int) -> dict[str, float]:
    """The joint targets of `raw` against what the robot itself knows of its joints at the time."""
    commands = [deserialize_message(data, JointState) for data in raw]
    stamps = np.array([stamp_nanoseconds(command.header.stamp) for command in commands])
    targets = np.array([joint_state_arrays(command, JOINT_NAMES)[0] for command in commands])
    trace = arm.trace()
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


def statistics(arm: MovingArm) -> dict[str, float | str]:
    """What the driver says of its cycles."""
    status = arm.harness.status
    counted = {name: float(status[name]) for name in STATISTICS}
    per_thousand = round(1e3 * int(status["commands"]) / counted["cycles"])
    return {
        "state": status["state"],
        "message": arm.harness.message,
        **counted,
        "commands_per_1000": per_thousand,
    }


def track(control: str, seconds: float, pace: float = 1.0) -> dict[str, object]:
    """Impedance tracking for so long of the robot's time."""
    with MovingArm(control, pace=pace, priority=pace == 1.0) as arm:
        harness, begin = arm.harness, NOMINAL.ready
        harness.wait(lambda: len(harness.states) > 200, "states")
        offset = clock_offset(arm)
        deafen(arm)
        with overheard(arm) as raw:
            for number in range(round(seconds / PIECE)):
                harness.probe.publish(
                    "joint_trajectory", trajectory_message(0, JOINT_NAMES, *waves(begin, number)), qos.EVENT
                )
                last = arm.robot.request("state")["time"] + PIECE + 0.2
                harness.probe.wait_until(
                    lambda: arm.state()["time"] > last, 100 * PIECE, "the end of a trajectory"
                )
        harness.probe.idle_for(1.1)  # for the statistics of the last second
        return {"control": control, "seconds": seconds, **tracking(arm, raw, offset), **statistics(arm)}


def approach(control: str, pace: float = 1.0, seed: int = 0) -> dict[str, object]:
    """Phases pre and approach of a card episode: keypoints of a card that stands still, real weights, RRT*,
    the driver.
    """
    domain = find_domain("card")
    task = sample_task(domain, np.random.default_rng(seed))
    corners, _ = CAMERA.project(
        box_keypoints(np.asarray(domain.half_size), task[0].position, task[0].quaternion)
    )
    seen = np.column_stack([corners, np.ones(len(corners))])
    with MovingArm(control, pace=pace, priority=pace == 1.0) as arm:
        harness, probe = arm.harness, arm.harness.probe
        phases = probe.collect("phase", String, qos.LATCHED)
        plans = probe.collect("joint_trajectory", JointTrajectory, qos.EVENT)
        poses = probe.collect("pre_contact_pose", PoseStamped, qos.EVENT)
        probe.advertise("keypoints", PointCloud2)
        probe.advertise("goal_pose", PoseStamped, qos.LATCHED)
        names = {
            harness.graph.run("np_policy", name, {"mode": "realtime", **more})
            for name, more in (
                ("pre_contact", {}),
                ("approach", {"seed": seed}),
                ("episode", {"backend": "franka_driver"}),
            )
        }
        probe.wait_until_ready(names)
        probe.publish(
            "goal_pose",
            pose_message(harness.stamp, BASE_FRAME, task[1].position, task[1].quaternion),
            qos.LATCHED,
        )
        start = probe.node.create_client(Trigger, "episode/start")
        answer = start.call_async(Trigger.Request())

        def reached(phase: str) -> bool:
            """Shows the card, as a detector would at 30 Hz, until the phase has come."""
            probe.publish("keypoints", keypoints_message(harness.stamp, CAMERA_NAME, seen))
            probe.idle_for(0.03)
            ended = [message.data for message in phases if message.data.startswith(("failed", "fault"))]
            if ended:
                raise RuntimeError(f"the approach ended with {ended[0]}")
            return any(message.data.startswith(phase) for message in phases)

        with overheard(arm) as raw:
            harness.wait(
                lambda: reached("post"), f"the end of the approach, after {[m.data for m in phases]}"
            )
            arm.rest()
        assert answer.done() and answer.result().success, answer
        _, positions, _ = trajectory_arrays(plans[-1], JOINT_NAMES)
        position, quaternion = pose_arrays(poses[-1], BASE_FRAME)
        q = np.array(arm.robot.request("state")["q"])
        at, rotation = forward_kinematics(q)
        duration = plans[-1].points[-1].time_from_start
        return {
            "control": control,
            "phases": [message.data for message in phases],
            "plan_s": round(duration.sec + duration.nanosec * 1e-9, 2),
            "plan_points": len(positions),
            "end_joint_error_rad": round(float(np.abs(positions[-1] - q).max()), 5),
            "end_hand_error_mm": round(float(1e3 * np.linalg.norm(at - position)), 2),
            "end_hand_error_deg": round(
                float(np.degrees(rotation_angle(quaternion, quaternion_from_matrix(rotation)))), 2
            ),
            **tracking(arm, raw, clock_offset(arm)),
            **statistics(arm),
        }
