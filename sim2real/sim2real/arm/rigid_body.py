"""Rigid-body dynamics of an `Arm` for many states at once, in numpy, and their inertial regressor.

Newton-Euler from the base outwards, each link in its own frame (Featherstone 2008, 5.3). n states, k joints; inside,
vectors are component first, (3, n) and (3, 3, n), so that numpy runs along contiguous states. Rotors and joint
friction are not part of it.

Why not Pinocchio: it takes one state a call. On a recording of the excitation suite (170 s; one core, CPU time) the
torques of its 84 800 control periods take .106 s here and .146 s in a loop over pinocchio.rnea; of its 4238 samples,
the regressor .021 s and .026 s, the slope of gravity .005 s and .012 s; its import takes another .1 s of a quick look.
The tests hold this module against Pinocchio.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim2real.arm.model import Arm

PARAMETERS = 10  # of a link: m, m c (3), inertia about its joint's origin (xx, xy, yy, xz, yz, zz)
PAIRS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
CHUNK = 4096  # states that fit into the cache together


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """Each link's motion in its own frame, k links and n states."""

    rate: np.ndarray
    """(k, 3, n) rad/s."""
    turning: np.ndarray
    """(k, 3, n) rad/s^2."""
    linear: np.ndarray
    """(k, 3, n) m/s^2, acceleration of the joint's origin, with gravity as an upward acceleration."""
    origin: np.ndarray
    """(k, 3, n) m in the world."""
    rotation: np.ndarray
    """(k, 3, 3, n), link to world."""
    axis: np.ndarray
    """(k, 3, n) in the world."""


def forward_recursion(arm: Arm, q, dq=None, ddq=None, gravity=None) -> LinkMotion:
    """Motion of the links at q (n, k) rad, dq, ddq (None: zero), under gravity (3,) m/s^2 (None: the arm's)."""
    n, k = q.shape
    rate, turning, linear, origin, axis = (np.zeros((k, 3, n)) for _ in range(5))
    rotation = np.empty((k, 3, 3, n))
    upward = np.tile(-np.asarray(arm.gravity if gravity is None else gravity, float)[:, None], (1, n))
    for i in range(k):
        p, turn, hinge = arm.parent[i], _joint_rotation(arm, i, q[:, i]), arm.axis[i][:, None]
        if p < 0:
            linear[i] = _rotate_back(turn, upward)
            origin[i], rotation[i] = arm.offset[i][:, None], turn
        else:
            w, a, arms = rate[p], turning[p], arm.offset[i]
            rate[i], turning[i] = _rotate_back(turn, w), _rotate_back(turn, a)
            linear[i] = _rotate_back(turn, linear[p] + _cross(a, arms) + _cross(w, _cross(w, arms)))
            origin[i] = origin[p] + _rotate(rotation[p], arms)
            rotation[i] = _compose(rotation[p], turn)
        if dq is not None:
            spin = hinge * dq[:, i]
            turning[i] += _cross(rate[i], spin)
            rate[i] += spin
        if ddq is not None:
            turning[i] += hinge * ddq[:, i]
        axis[i] = _rotate(rotation[i], arm.axis[i])
    return LinkMotion(rate, turning, linear, origin, rotation, axis)


def inverse_dynamics(arm: Arm, q, dq=None, ddq=None, gravity=None) -> np.ndarray:
    """Joint torque (n, k) Nm that the motion takes, gravity included unless `gravity` is zero."""
    if len(q) > CHUNK:
        parts = [slice(start, start + CHUNK) for start in range(0, len(q), CHUNK)]
        some = [[None if x is None else x[part] for x in (q, dq, ddq)] for part in parts]
        return np.concatenate([inverse_dynamics(arm, *states, gravity) for states in some])
    motion = forward_recursion(arm, q, dq, ddq, gravity)
    n, k = q.shape
    force, couple = np.zeros((k, 3, n)), np.zeros((k, 3, n))  # in the world, couple about the world's origin
    for i in range(k):
        w, a, b, h = motion.rate[i], motion.turning[i], motion.linear[i], arm.moment[i]
        f = arm.mass[i] * b + _cross(a, h) + _cross(w, _cross(w, h))
        m = arm.inertia[i] @ a + _cross(w, arm.inertia[i] @ w) - _cross(b, h)
        force[i] = _rotate(motion.rotation[i], f)
        couple[i] = _rotate(motion.rotation[i], m) + _cross(motion.origin[i], force[i])
    for i in range(k - 1, -1, -1):
        if arm.parent[i] >= 0:
            force[arm.parent[i]] += force[i]
            couple[arm.parent[i]] += couple[i]
    about = couple - np.stack([_cross(o, f) for o, f in zip(motion.origin, force)])
    return np.ascontiguousarray((motion.axis * about).sum(axis=1).T)


def feedforward_torque(arm: Arm, q, dq, ddq) -> np.ndarray:
    """Joint torque (n, k) Nm that the acceleration ddq takes, rotors included, without gravity: what the controller feeds forward."""
    return inverse_dynamics(arm, q, dq, ddq, np.zeros(3)) + arm.armature * ddq


def links_moved_by(arm: Arm, joint: int) -> list[int]:
    """Links that a joint turns."""
    found = []
    for link in range(len(arm)):
        i = link
        while i > joint:
            i = int(arm.parent[i])
        if i == joint:
            found.append(link)
    return found


def link_inertia_traces(arm: Arm) -> np.ndarray:
    """Each link's own inertia (k,) kg m^2 as a number: its trace; of the first link, that about its axis."""
    return np.array(
        [
            axis @ inertia @ axis if p < 0 else np.trace(inertia)
            for axis, inertia, p in zip(arm.axis, central_inertia(arm), arm.parent)
        ]
    )


def drive_inertia(arm: Arm, q) -> np.ndarray:
    """Inertia (k,) kg m^2 that each drive feels at q (k,): diagonal of the mass matrix, rotors included."""
    count = len(arm)
    still = np.tile(q, (count, 1))
    return np.diag(inverse_dynamics(arm, still, np.zeros_like(still), np.eye(count), np.zeros(3))) + arm.armature


def gravity_torque(arm: Arm, q, gravity=None) -> np.ndarray:
    """Torque (n, k) Nm that holds the arm; linear in gravity (3,) m/s^2."""
    return inverse_dynamics(arm, q, gravity=gravity)


def gravity_slope(arm: Arm, q) -> np.ndarray:
    """Change (n, k, k) Nm/rad of joint i's gravity torque with position j; symmetric."""
    motion = forward_recursion(arm, q)
    n, k = q.shape
    mass, moment = arm.mass.copy(), np.zeros((k, 3, n))  # of all that a joint carries, in the world
    for i in range(k):
        moment[i] = _rotate(motion.rotation[i], arm.moment[i])
    for i in range(k - 1, -1, -1):
        p = arm.parent[i]
        if p >= 0:
            moment[p] += moment[i] + mass[i] * (motion.origin[i] - motion.origin[p])
            mass[p] += mass[i]
    slope = np.zeros((n, k, k))
    for j in range(k):
        pull = _cross(_cross(motion.axis[j], moment[j]), arm.gravity)
        i = j
        while i >= 0:
            slope[:, i, j] = slope[:, j, i] = -(motion.axis[i] * pull).sum(axis=0)
            i = arm.parent[i]
    return slope


def regressor(arm: Arm, motion: LinkMotion, link: int) -> np.ndarray:
    """Change (n, k, 10) of the joint torques with the inertial parameters of one link, in `PARAMETERS` order."""
    k, _, n = motion.rate.shape
    w, a, b = motion.rate[link], motion.turning[link], motion.linear[link]
    forces, couples = np.zeros((PARAMETERS, 3, n)), np.zeros((PARAMETERS, 3, n))
    forces[0] = b
    for axis, unit in enumerate(np.eye(3)):
        forces[1 + axis] = _cross(a, unit) + _cross(w, _cross(w, unit))
        couples[1 + axis] = -_cross(b, unit)
    for number, (r, c) in enumerate(PAIRS):
        basis = np.zeros((3, 3))
        basis[r, c] = basis[c, r] = 1.0
        couples[4 + number] = basis @ a + _cross(w, basis @ w)
    columns = np.zeros((n, k, PARAMETERS))
    joint = link
    while joint >= 0:
        axis = _rotate_back(motion.rotation[link], motion.axis[joint])
        lever = _rotate_back(motion.rotation[link], motion.origin[link] - motion.origin[joint])
        columns[:, joint] = ((couples * axis).sum(axis=1) + (forces * _cross(axis, lever)).sum(axis=1)).T
        joint = arm.parent[joint]
    return columns


def link_inertia_torque(arm: Arm, motion: LinkMotion) -> np.ndarray:
    """Torque (n, k, k) Nm of joint i that turns link j about its own centre of mass: what a share of that
    inertia would add."""
    parts = [
        regressor(arm, motion, link)[:, :, 4:] @ np.array([about[pair] for pair in PAIRS])
        for link, about in enumerate(central_inertia(arm))
    ]
    return np.stack(parts, axis=2)


def mass_centre_change(arm: Arm, link: int) -> np.ndarray:
    """Change (10, 3) of a link's `PARAMETERS` with its m c along x, y, z: the mass moves, its inertia about its centre stays,
    and that about the joint goes along, to first order."""
    centre = arm.moment[link] / max(arm.mass[link], 1e-9)
    about = [2 * centre @ u * np.eye(3) - np.outer(centre, u) - np.outer(u, centre) for u in np.eye(3)]
    inertia = np.array([[change[pair] for change in about] for pair in PAIRS])
    return np.vstack([np.zeros((1, 3)), np.eye(3), inertia])


def central_inertia(arm: Arm) -> np.ndarray:
    """Inertia (k, 3, 3) kg m^2 of each link about its own centre of mass."""
    shifts = [(h @ h * np.eye(3) - np.outer(h, h)) / max(m, 1e-9) for m, h in zip(arm.mass, arm.moment)]
    return arm.inertia - np.array(shifts)


def _joint_rotation(arm: Arm, joint: int, angle: np.ndarray) -> np.ndarray:
    """Rotation (3, 3, n) of a link in its parent, Rodrigues' formula."""
    x, y, z = arm.axis[joint]
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    delta = angle - arm.reference[joint]
    fixed, first, second = (arm.rotation[joint] @ part for part in (np.eye(3), skew, skew @ skew))
    return fixed[..., None] + first[..., None] * np.sin(delta) + second[..., None] * (1 - np.cos(delta))


def _rotate(rotation: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """(3, n) of rotations (3, 3, n) and vectors (3, n) or one (3,)."""
    return rotation[:, 0] * vector[0] + rotation[:, 1] * vector[1] + rotation[:, 2] * vector[2]


def _rotate_back(rotation: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """The same of the inverse rotations."""
    return rotation[0] * vector[0] + rotation[1] * vector[1] + rotation[2] * vector[2]


def _compose(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(3, 3, n) of (3, 3, n) each."""
    return np.stack([_rotate(one, other[:, c]) for c in range(3)], axis=1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(3, n) of (3, n) and (3, n) or one (3,)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
