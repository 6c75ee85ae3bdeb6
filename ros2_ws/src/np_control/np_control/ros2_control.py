"""Our joint targets and gains as controllers of ros2_control take them.

CRISP (crisp_controllers, its joint impedance controller): topic `target_joint`, parameters `nullspace.stiffness` and
`nullspace.damping`, a value a joint (src/cartesian_controller.yaml, include/crisp_controllers/utils/nullspace_gains.hpp).
joint_trajectory_controller on effort interfaces: topic `~/joint_trajectory`, parameters `gains.<joint>.p` and `.d`
(ros2_controllers, joint_trajectory_controller_parameters.yaml); its torque is p (q_d - q) + d (dq_d - dq).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy

import numpy as np
from builtin_interfaces.msg import Time
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from np_control.impedance import damping
from np_control.safety import SafetyLimits
from np_description.message_arrays import BadMessage, trajectory_arrays

CRISP, JTC = CONTROLLERS = ("crisp", "joint_trajectory_controller")
START_TOLERANCE = 0.01
"""rad; MoveIt's allowed_start_tolerance. The controller itself has none: it would jump."""


def gain_parameters(controller: str, joints: Sequence[str], stiffness, damping_ratio) -> dict[str, float | list[float]]:
    """The controller's parameters for stiffness (7,) Nm/rad and damping ratio (7,), kd = rho sqrt(kp); joints: its names."""
    kp, kd = np.asarray(stiffness, float), damping(np.asarray(stiffness, float), np.asarray(damping_ratio, float))
    if controller == CRISP:
        return {"nullspace.stiffness": kp.tolist(), "nullspace.damping": kd.tolist()}
    pairs = zip(joints, kp.tolist(), kd.tolist(), strict=True)
    return {f"gains.{joint}.{part}": value for joint, p, d in pairs for part, value in (("p", p), ("d", d))}


def target_trajectory(joints: Sequence[str], target) -> JointTrajectory:
    """One joint target (7,) rad, to be followed at once and held."""
    message = JointTrajectory(joint_names=list(joints))
    message.points.append(JointTrajectoryPoint(positions=np.asarray(target, float).tolist()))
    return message


def as_controller_takes(trajectory: JointTrajectory, joints: Sequence[str]) -> JointTrajectory:
    """A plan of the topic `joint_trajectory` under the controller's names.

    The stamp is 0, from now on: ours is that of the keypoints, which the controller would take for the start. It refuses
    trajectories with efforts; our zeros, which readers of bags need, are dropped.
    """
    message = deepcopy(trajectory)
    message.header.stamp, message.joint_names = Time(), list(joints)
    for point in message.points:
        point.effort, point.accelerations = [], []
    return message


def check_trajectory(message: JointTrajectory, joints: Sequence[str], measured, limits: SafetyLimits) -> None:
    """Hold a trajectory to the rules of joint_trajectory_controller (validate_trajectory_msg) and to the limits.

    measured: joints (7,) rad now. Raises BadMessage, which names the rule: its joints and no others; times that increase;
    as many numbers as joints, no efforts; rest at the end; a start within START_TOLERANCE; positions within limits.
    """
    times, positions, velocities = trajectory_arrays(message, joints)
    if not times.size:
        raise BadMessage("shape", "JointTrajectory: expected points, got none")
    if message.header.stamp != Time():
        raise BadMessage(
            "stamp", "JointTrajectory.header.stamp: expected 0, from now on, got the time of something else"
        )
    if any(len(point.effort) for point in message.points):
        raise BadMessage(
            "shape", "JointTrajectory.points.effort: expected none, which the controller refuses, got some"
        )
    if np.abs(velocities[-1]).max() > np.finfo(np.float32).eps:
        raise BadMessage("range", f"JointTrajectory: expected rest at the end, got {velocities[-1].tolist()} rad/s")
    error = np.abs(positions[0] - measured)
    if error.max() > START_TOLERANCE:
        raise BadMessage(
            "range",
            f"JointTrajectory: expected a start within {START_TOLERANCE} rad of the measured position, "
            f"got {error.max():.4f} rad at {joints[int(error.argmax())]}",
        )
    outside = (positions < limits.position_lower) | (positions > limits.position_upper)
    if outside.any():
        point, joint = np.argwhere(outside)[0]
        raise BadMessage(
            "range",
            f"JointTrajectory: expected {joints[joint]} within its limits, got {positions[point, joint]:.4f} rad "
            f"at point {point}",
        )
