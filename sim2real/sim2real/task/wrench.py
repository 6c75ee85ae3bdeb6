"""The force on the fingertips from joint torques: what drives give beyond what the arm itself takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_control.dynamics import Dynamics
from np_control.kinematics import forward_kinematics, jacobian
from np_description.panda import NOMINAL, PandaModel
from sim2real.excitation.contact_suite.tip import CORNERS, HALF
from sim2real.recordings.signals import Log
from sim2real.thresholds import THRESHOLDS

FORCE = THRESHOLDS.tip_force


@dataclass(frozen=True, eq=False)
class ArmMotion:
    """A stretch of a recording at `FORCE.rate` rows a second."""

    time: np.ndarray
    """Times (n,) s."""
    position: np.ndarray
    """Joint positions (n, 7) rad."""
    velocity: np.ndarray
    """Joint velocities (n, 7) rad/s."""
    excess: np.ndarray
    """Torques (n, 7) Nm of the drives beyond inertia, friction and damping of the arm."""
    tip: np.ndarray
    """Middle (n, 3) m of the fingertips' end."""
    turn: np.ndarray
    """Rotations (n, 3, 3) of the hand."""
    moves: np.ndarray
    """Velocities (n, 3) m/s of the tip."""

    def __len__(self) -> int:
        return len(self.time)

    def free(self, rows: np.ndarray) -> np.ndarray:
        """Mean excess (7,) Nm of rows in which nothing is touched: what the arm's model lacks at this posture and speed."""
        return self.excess[rows].mean(axis=0)

    def turning(self, rows: np.ndarray) -> np.ndarray:
        """Way (7,) in which each joint turns in rows, 1 or -1; 0 where it does not turn all the time."""
        directions = np.where(np.abs(self.velocity[rows]) > FORCE.turned, np.sign(self.velocity[rows]), 0.0)
        return np.where((directions == directions[:1]).all(axis=0), directions[0], 0.0)


def arm_motion(log: Log, rows: slice, panda: PandaModel = NOMINAL) -> ArmMotion:
    """The stretch in some rows of a log; panda: the arm as it is, its own gap included."""
    time, q, dq = log.time[rows], log.position[rows], log.velocity[rows]
    torque = np.column_stack([np.interp(time, log.torque_time, column) for column in log.torque.T])
    if log.with_gravity:
        gravity = Dynamics(panda).gravity
        torque = torque - np.array([gravity(one) for one in q])
    width = max(1, round(1 / FORCE.rate / float(np.median(np.diff(time)))))
    count = len(time) // width
    at, q, dq, torque = (
        values[: count * width].reshape(count, width, -1).mean(axis=1) for values in (time[:, None], q, dq, torque)
    )
    at = at[:, 0]
    acceleration = np.gradient(dq, at, axis=0)
    dynamics = Dynamics(panda)
    inertial = np.array([dynamics.feedforward(*state) for state in zip(q, dq, acceleration)])
    friction = panda.frictionloss * np.clip(dq / FORCE.turned, -1, 1) + panda.damping * dq
    position, turn = forward_kinematics(q, panda)
    tip = position + turn @ CORNERS.mean(axis=0)
    return ArmMotion(at, q, dq, torque - inertial - friction, tip, turn, np.gradient(tip, at, axis=0))


def tip_forces(
    moved: ArmMotion,
    free: np.ndarray,
    points: np.ndarray | None = None,
    panda: PandaModel = NOMINAL,
    turning: np.ndarray | None = None,
) -> np.ndarray:
    """Force (n, 3) N on the hand in the base frame, by weighted least squares over the joints.

    points (n, 3) m: where the hand is touched, and no moment acts; None: anywhere, with a moment. free (7,) or (n, 7) Nm: excess without
    contact; turning (7,): of its rows, see `Motion.turning`. A joint that hardly moves counts little, and so does one that did not turn the same
    way where nothing was touched: the direction of its friction is unknown.
    """
    inverse, deviation = _weighted_inverse(moved, points, panda, turning)
    return np.einsum("nij,nj->ni", inverse, -(moved.excess - free) / deviation)[:, :3]


def tip_force_covariance(
    moved: ArmMotion,
    points: np.ndarray | None = None,
    panda: PandaModel = NOMINAL,
    turning: np.ndarray | None = None,
) -> np.ndarray:
    """Covariance (n, 3, 3) N^2 of `tip_forces`, all rows alike: of the joints' errors, of which a stretch without contact at the same speed,
    taken off, leaves `FORCE.left`."""
    inverse, _ = _weighted_inverse(moved, points, panda, turning)
    return FORCE.left**2 * (inverse @ np.swapaxes(inverse, 1, 2))[:, :3, :3]


def _weighted_inverse(
    moved: ArmMotion, points: np.ndarray | None, panda: PandaModel, turning: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Inverse (n, 3 or 6, 7) that makes forces of joint torques over their deviations (n, 7) Nm."""
    jac = jacobian(moved.position, panda)
    if points is not None:
        arm = points - forward_kinematics(moved.position, panda)[0]
        jac = jac[:, :3] + np.cross(jac[:, 3:], arm[:, :, None], axis=1)
    unknown = np.abs(moved.velocity) < FORCE.turned
    if turning is not None:
        unknown |= np.sign(moved.velocity) != turning
    deviation = FORCE.torque + np.where(unknown, panda.frictionloss, FORCE.friction * panda.frictionloss)
    return np.linalg.pinv(np.swapaxes(jac, 1, 2) / deviation[..., None]), deviation


def leading_corner(direction: np.ndarray, turn: np.ndarray, tip: np.ndarray) -> np.ndarray:
    """The corner (n, 3) m of the block that leads in a direction (3,), in the middle of what touches a face."""
    corners = tip[:, None] + np.einsum("nij,kj->nki", turn, CORNERS - CORNERS.mean(axis=0))
    ahead = corners[np.arange(len(corners)), (corners @ direction).argmax(axis=1)]
    return ahead + [0.0, 0.0, HALF[0]]
