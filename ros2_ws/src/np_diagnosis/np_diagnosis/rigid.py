"""Rigid-body dynamics of an `Arm` for many states at once, in numpy, and their inertial regressor.

Newton-Euler from the base outwards, each link in its own frame (Featherstone 2008, 5.3). All arrays are over
states first: n states, k joints. Rotors and joint friction are not part of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_diagnosis.arm_model import Arm

PARAMETERS = 10  # of a link: m, m c (3), inertia about its joint's origin (xx, xy, yy, xz, yz, zz)
PAIRS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


@dataclass(frozen=True, eq=False)
class Motion:
    """Each link's motion in its own frame: rate, turning, linear (n, k, 3) rad/s, rad/s^2, m/s^2, the last of
    the joint's origin and with gravity as an upward acceleration; origin (n, k, 3) m and rotation (n, k, 3, 3)
    in the world; axis (n, k, 3) in the world."""

    rate: np.ndarray
    turning: np.ndarray
    linear: np.ndarray
    origin: np.ndarray
    rotation: np.ndarray
    axis: np.ndarray


def move(arm: Arm, q, dq=None, ddq=None, gravity=None) -> Motion:
    """Motion of the links at q (n, k) rad, dq, ddq (None: zero), under gravity (3,) m/s^2 (None: the arm's)."""
    n, k = q.shape
    rate, turning, linear, origin = (np.zeros((n, k, 3)) for _ in range(4))
    rotation, axis = np.empty((n, k, 3, 3)), np.empty((n, k, 3))
    gravity = arm.gravity if gravity is None else np.asarray(gravity)
    for i in range(k):
        p, turn = arm.parent[i], _turn(arm, i, q[:, i])
        back = turn.transpose(0, 2, 1)
        if p < 0:
            linear[:, i] = _apply(back, np.broadcast_to(-gravity, (n, 3)))
            origin[:, i], rotation[:, i] = arm.offset[i], turn
        else:
            arms = np.broadcast_to(arm.offset[i], (n, 3))
            w, a = rate[:, p], turning[:, p]
            rate[:, i], turning[:, i] = _apply(back, w), _apply(back, a)
            linear[:, i] = _apply(back, linear[:, p] + _cross(a, arms) + _cross(w, _cross(w, arms)))
            origin[:, i] = origin[:, p] + _apply(rotation[:, p], arms)
            rotation[:, i] = rotation[:, p] @ turn
        if dq is not None:
            spin = arm.axis[i] * dq[:, i, None]
            turning[:, i] += _cross(rate[:, i], spin)
            rate[:, i] += spin
        if ddq is not None:
            turning[:, i] += arm.axis[i] * ddq[:, i, None]
        axis[:, i] = rotation[:, i] @ arm.axis[i]
    return Motion(rate, turning, linear, origin, rotation, axis)


def torque(arm: Arm, q, dq=None, ddq=None, gravity=None) -> np.ndarray:
    """Joint torque (n, k) Nm that the motion takes, gravity included unless `gravity` is zero."""
    motion = move(arm, q, dq, ddq, gravity)
    n, k = q.shape
    force, couple = np.zeros((n, k, 3)), np.zeros((n, k, 3))  # in the world, couple about the world's origin
    for i in range(k):
        w, a, b = motion.rate[:, i], motion.turning[:, i], motion.linear[:, i]
        h = np.broadcast_to(arm.moment[i], w.shape)
        f = arm.mass[i] * b + _cross(a, h) + _cross(w, _cross(w, h))
        m = a @ arm.inertia[i] + _cross(w, w @ arm.inertia[i]) + _cross(h, b)
        force[:, i] = _apply(motion.rotation[:, i], f)
        couple[:, i] = _apply(motion.rotation[:, i], m) + _cross(motion.origin[:, i], force[:, i])
    for i in range(k - 1, -1, -1):
        if arm.parent[i] >= 0:
            force[:, arm.parent[i]] += force[:, i]
            couple[:, arm.parent[i]] += couple[:, i]
    about = couple - _cross(motion.origin, force)
    return (motion.axis * about).sum(axis=2)


def gravity_torque(arm: Arm, q, gravity=None) -> np.ndarray:
    """Torque (n, k) Nm that holds the arm; linear in gravity (3,) m/s^2."""
    return torque(arm, q, gravity=gravity)


def gravity_slope(arm: Arm, q) -> np.ndarray:
    """Change (n, k, k) Nm/rad of joint i's gravity torque with position j; symmetric."""
    motion = move(arm, q)
    n, k = q.shape
    mass, moment = np.tile(arm.mass, (n, 1)), np.zeros((n, k, 3))  # of all that a joint carries, in the world
    for i in range(k):
        moment[:, i] = motion.rotation[:, i] @ arm.moment[i]
    for i in range(k - 1, -1, -1):
        p = arm.parent[i]
        if p >= 0:
            lever = motion.origin[:, i] - motion.origin[:, p]
            moment[:, p] += moment[:, i] + mass[:, i, None] * lever
            mass[:, p] += mass[:, i]
    slope = np.zeros((n, k, k))
    for j in range(k):
        pull = _cross(_cross(motion.axis[:, j], moment[:, j]), np.broadcast_to(arm.gravity, (n, 3)))
        i = j
        while i >= 0:
            slope[:, i, j] = slope[:, j, i] = -(motion.axis[:, i] * pull).sum(axis=1)
            i = arm.parent[i]
    return slope


def regressor(arm: Arm, motion: Motion, link: int) -> np.ndarray:
    """Change (n, k, 10) of the joint torques with the inertial parameters of one link, in `PARAMETERS` order."""
    n, k, _ = motion.rate.shape
    w, a, b = motion.rate[:, link], motion.turning[:, link], motion.linear[:, link]
    forces, couples = np.zeros((n, PARAMETERS, 3)), np.zeros((n, PARAMETERS, 3))
    forces[:, 0] = b
    for axis in range(3):
        unit = np.broadcast_to(np.eye(3)[axis], w.shape)
        forces[:, 1 + axis] = _cross(a, unit) + _cross(w, _cross(w, unit))
        couples[:, 1 + axis] = _cross(unit, b)
    for number, (r, c) in enumerate(PAIRS):
        basis = np.zeros((3, 3))
        basis[r, c] = basis[c, r] = 1.0
        couples[:, 4 + number] = a @ basis + _cross(w, w @ basis)
    back = motion.rotation[:, link].transpose(0, 2, 1)
    columns = np.zeros((n, k, PARAMETERS))
    joint = link
    while joint >= 0:
        axis = _apply(back, motion.axis[:, joint])
        lever = _apply(back, motion.origin[:, link] - motion.origin[:, joint])
        columns[:, joint] = np.einsum("npc,nc->np", couples, axis)
        columns[:, joint] += np.einsum("npc,nc->np", forces, _cross(axis, lever))
        joint = arm.parent[joint]
    return columns


def _turn(arm: Arm, joint: int, angle: np.ndarray) -> np.ndarray:
    """Rotation (n, 3, 3) of a link in its parent, Rodrigues' formula."""
    x, y, z = arm.axis[joint]
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    delta = (angle - arm.reference[joint])[:, None, None]
    return arm.rotation[joint] @ (np.eye(3) + np.sin(delta) * skew + (1 - np.cos(delta)) * skew @ skew)


def _apply(rotation: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return (rotation * vector[..., None, :]).sum(axis=-1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """np.cross of (..., 3), several times as fast."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
