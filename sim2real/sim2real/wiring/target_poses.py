"""Conventions of `target_pose`: the controller's joint target, by forward kinematics, against the target pose it was computed from.

The joint target of a pose is its inverse kinematics, so that the two differ by less than a millimetre where frame, quaternion and scale are right.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from np_common.rotations import matrix_from_quaternion, vector_from_matrix
from np_control.kinematics import forward_kinematics
from np_description.panda import NOMINAL
from sim2real.recordings.signals import Log
from sim2real.thresholds import THRESHOLDS
from sim2real.wiring.fault import WiringFault

WIRING = THRESHOLDS.wiring
EFFECTIVE = 0.05  # s after its stamp, at which the controller follows a pose: later than its latency, earlier than the next pose
TOPIC = "target_pose"


@dataclass(frozen=True, eq=False)
class FramePoses:
    """Frames in the base frame."""

    position: np.ndarray
    """(n, 3) m."""
    rotation: np.ndarray
    """(n, 3, 3)."""

    def distance(self, other: FramePoses) -> float:
        """Median distance, in units of what is tolerated: position and rotation by their larger."""
        away = np.linalg.norm(self.position - other.position, axis=1) / WIRING.pose_position
        turn = np.einsum("nji,njk->nik", self.rotation, other.rotation)
        return float(np.median(np.maximum(away, np.linalg.norm(vector_from_matrix(turn), axis=1) / WIRING.pose_angle)))


def find_target_pose_fault(log: Log, stamps: np.ndarray, messages: np.ndarray) -> WiringFault | None:
    """stamps (n,) s of the log; messages (n, 7): x, y, z m and the quaternion as sent, which should be x, y, z, w."""
    c = log.commands
    if c is None:
        return None
    answered = np.searchsorted(log.time, stamps)
    rows = np.searchsorted(log.time[c.rows], stamps + EFFECTIVE)
    known = (rows < len(c.rows)) & (answered < len(log.time))
    if known.sum() < WIRING.least_poses:
        return None
    messages, rows, answered = messages[known], rows[known], answered[known]
    followed, measured = (
        FramePoses(*forward_kinematics(c.target[rows])),
        FramePoses(*forward_kinematics(log.position[answered])),
    )
    pose = FramePoses(messages[:, :3], matrix_from_quaternion(messages[:, [6, 3, 4, 5]]))
    if pose.distance(followed) < 1.0:
        return None
    found = [(one.distance(followed), fault) for one, fault in _candidates(messages, pose, followed, measured)]
    nearest, fault = min(found, key=lambda pair: pair[0])
    return fault if nearest < 1.0 else None


def _candidates(
    messages: np.ndarray, pose: FramePoses, followed: FramePoses, measured: FramePoses
) -> Iterator[tuple[FramePoses, WiringFault]]:
    """FramePoses (n) of T_E in the base frame, if a convention is another one, and the fault that it is."""
    other = FramePoses(pose.position, matrix_from_quaternion(messages[:, 3:]))
    yield (
        other,
        WiringFault(
            "quaternion",
            TOPIC,
            "Quaternions of target_pose are w x y z; the controller follows them as x y z w.",
            "Send orientation as x, y, z, w.",
        ),
    )
    tool, flange = NOMINAL.frames["hand_tcp"], NOMINAL.frames["link7_hand"]
    turn = matrix_from_quaternion(flange.quaternion)
    ahead = pose.rotation @ tool.position
    for name, rotation in (("hand", pose.rotation), ("flange", pose.rotation @ turn)):
        yield (
            FramePoses(pose.position + ahead, rotation),
            WiringFault(
                "frame",
                TOPIC,
                f"target_pose is the pose of the {name}, {1e3 * tool.position[2]:.1f} mm behind the tool point T_E.",
                "Send the pose of panda_tcp, between the fingertips.",
            ),
        )
    relative = FramePoses(
        measured.position + np.einsum("nij,nj->ni", measured.rotation, pose.position), measured.rotation @ pose.rotation
    )
    yield (
        relative,
        WiringFault(
            "frame",
            TOPIC,
            "target_pose is in the frame of the tool, relative to where it was; the contract has the base frame.",
            "Multiply it from the left by the measured pose of panda_tcp.",
        ),
    )
    for quarter in (1, 2, 3):
        c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter]
        base = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        yield (
            FramePoses(pose.position @ base.T, base @ pose.rotation),
            WiringFault(
                "frame",
                TOPIC,
                f"The frame of target_pose is rotated by {-90 * quarter % 360} degrees about z from panda_link0.",
                f"Rotate its poses by {90 * quarter} degrees about z.",
            ),
        )
    step, went = pose.position - measured.position, followed.position - measured.position
    scale = float((step * went).sum() / max((step * step).sum(), 1e-12))
    if scale > 0 and abs(np.log(scale)) > np.log(WIRING.action_scale):
        yield (
            FramePoses(measured.position + scale * step, followed.rotation),
            WiringFault(
                "action_scale",
                TOPIC,
                f"Steps of target_pose from the measured pose are {1 / scale:.3g} times what the controller follows.",
                f"Multiply actions by {scale:.3g}, or give both sides the same action scale.",
            ),
        )
