"""The wiring of a recording: read it, and name the convention that it breaks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA
from np_description.domains import Task
from np_description.message_arrays import BadMessage, image_array, keypoints_array, stamp_nanoseconds
from np_description.panda import JOINT_NAMES
from np_description.weights.released import WeightsError
from np_record.bag import BagError, Recording
from np_record.recorded_episode import read_recorded_task
from sim2real.arm.model import Arm
from sim2real.recordings.reading import SECOND, bag_violation, load_log
from sim2real.recordings.signals import Log
from sim2real.wiring.clocks import find_clock_fault
from sim2real.wiring.delays import find_delay_fault
from sim2real.wiring.fault import WiringFault
from sim2real.wiring.joint_faults import find_joint_fault
from sim2real.wiring.joint_relations import JointRelations
from sim2real.wiring.joint_signals import joint_signals
from sim2real.wiring.picture import find_image_fault, find_keypoint_fault
from sim2real.wiring.reported_signals import find_signal_fault
from sim2real.wiring.target_poses import find_target_pose_fault

CLOCKED = ("joint_states", "effort_command", "camera/image_raw", "keypoints", "target_pose")
POSES, IMAGES, DETECTED = 1000, 300, 4  # messages of target_pose, keypoints and images that are compared, at most


@dataclass(frozen=True, eq=False)
class WiringRecording:
    """What the wiring of a bag is determined from, beside its joints. Stamps are ns of the messages' headers."""

    headers: dict[str, np.ndarray]
    """By topic, stamps (n,)."""
    arrivals: dict[str, np.ndarray]
    """By topic, times (n,) ns at which messages were recorded."""
    poses: np.ndarray
    """`target_pose` (n, 7): position m and quaternion as sent."""
    pose_stamps: np.ndarray
    """(n,)."""
    keypoints: np.ndarray
    """(m, 8, 3) u px, v px, score."""
    keypoint_stamps: np.ndarray
    """(m,)."""
    images: np.ndarray
    """(l, height, width, 3) as recorded."""
    domain: Task | None
    """The task's object, where the bag names one."""
    calibration: str
    """Calibration of the camera that the bag names; the nominal one where empty."""


def read_wiring(path: str | Path) -> WiringRecording:
    """A rosbag2 recording. Raises ContractViolation."""
    try:
        with Recording(path) as recording:
            headers, arrivals = {}, {}
            for topic in (topic for topic in CLOCKED if recording.counts.get(topic)):
                stamps, times = recording.times(topic)
                if stamps.any():
                    headers[topic], arrivals[topic] = stamps, times
            rows = recording.rows("keypoints", "camera/image_raw", "target_pose")
            poses, keypoints, images = (
                [rows[topic][n].decode() for n in _spread(len(rows[topic]), most)] if topic in rows else []
                for topic, most in (("target_pose", POSES), ("keypoints", IMAGES), ("camera/image_raw", DETECTED))
            )
            return WiringRecording(
                headers,
                arrivals,
                np.array([_pose(message) for message in poses]).reshape(-1, 7),
                _stamps(poses),
                np.array([keypoints_array(message) for message in keypoints]).reshape(-1, 8, 3),
                _stamps(keypoints),
                np.array([image_array(message) for message in images]),
                read_recorded_task(recording) if recording.information.get("domain") else None,
                recording.information.get("calibration", ""),
            )
    except (BagError, BadMessage) as error:
        raise bag_violation(path, error) from error


def check_wiring(path: str | Path, arm: Arm, log: Log | None = None) -> WiringFault | None:
    """The fault of a log of an arm's joints that explains most; None where its physics contradicts no convention. log: if it is read already.

    Raises ContractViolation.
    """
    log = log or load_log(path, arm.joints)
    fault = find_wiring_fault(log, arm)
    if fault or Path(path).suffix == ".npz" or tuple(arm.joints) != JOINT_NAMES:
        return fault
    return find_stream_fault(read_wiring(path), log)


def find_wiring_fault(log: Log, arm: Arm) -> WiringFault | None:
    """Of joints alone."""
    fault = find_signal_fault(log, arm.joints) or find_delay_fault(log, arm)  # exact, where another sample is right
    relations = JointRelations(arm, log.with_gravity)
    return fault or find_joint_fault(joint_signals(log), relations, arm.joints, log.is_current)


def find_stream_fault(recording: WiringRecording, log: Log) -> WiringFault | None:
    """Of clocks, target poses and camera."""
    fault = find_clock_fault(recording.headers, recording.arrivals)
    if fault or "joint_states" not in recording.headers:
        return fault
    first = recording.headers["joint_states"][0]
    if len(recording.poses):
        fault = find_target_pose_fault(log, (recording.pose_stamps - first) / SECOND, recording.poses)
    if fault or recording.domain is None or recording.calibration:
        return fault
    # The detectors work with no others.
    if len(recording.images) and recording.images.shape[1:] == (CAMERA.height, CAMERA.width, 3):
        try:
            fault = find_image_fault(recording.images, recording.domain)
        except WeightsError:  # no detector was released for the object
            pass
    if fault or not len(recording.keypoints):
        return fault
    time = (recording.keypoint_stamps - first) / SECOND
    joints = np.column_stack([np.interp(time, log.time, column) for column in log.position.T])
    return find_keypoint_fault(recording.keypoints, recording.domain, forward_kinematics(joints)[0])


def _stamps(messages: Sequence) -> np.ndarray:
    """Header stamps (n,) ns."""
    return np.array([stamp_nanoseconds(message.header.stamp) for message in messages], np.int64)


def _pose(message) -> list[float]:
    p, q = message.pose.position, message.pose.orientation
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def _spread(count: int, most: int) -> range:
    """At most so many of `count` messages, evenly."""
    return range(0, count, max(1, -(-count // most)))
