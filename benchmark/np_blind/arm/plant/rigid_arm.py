"""Rigid-body dynamics of many arms at once, in world coordinates.

Spatial vectors are taken about the origin of the base, so that inertias, velocities and forces of links just
add up along the chain (Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 2 and 6): sums over the
links are cumulative sums, and only the rotations need a loop. Arrays are (3, B, 7): component, arm, link. Where shapes have 7, it
is 6 for the arm of six hinges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from np_common.rotations import matrix_from_quaternion
from np_description.panda import NOMINAL, Frame

JOINTS = 7
GRAVITY = 9.81
_UNIT = np.eye(3)


@dataclass(eq=False)
class Inertials:
    """Links of B arms: mass (B, 7) kg, com (B, 7, 3) m and inertia (B, 7, 3, 3) kg m^2 about the com in the
    frame of the link; gravity (B, 3) m/s^2 in the base frame. Hand and fingers belong to the last link.
    """

    mass: np.ndarray
    com: np.ndarray
    inertia: np.ndarray
    gravity: np.ndarray

    def stacked(self, other: Inertials) -> Inertials:
        """These arms, then the others."""
        return Inertials(
            *(
                np.concatenate([getattr(self, name), getattr(other, name)])
                for name in ("mass", "com", "inertia", "gravity")
            )
        )

    def take(self, rows: list[int]) -> Inertials:
        """These of the arms."""
        return Inertials(self.mass[rows], self.com[rows], self.inertia[rows], self.gravity[rows])

    def add_point(self, arm: int, link: int, mass: float, at: np.ndarray) -> None:
        """Fix a point mass, kg, at (3,) m in the frame of a link."""
        total = self.mass[arm, link] + mass
        apart = np.asarray(at) - self.com[arm, link]
        self.inertia[arm, link] += self.mass[arm, link] * mass / total * _spread(apart)
        self.com[arm, link] += mass / total * apart
        self.mass[arm, link] = total


@dataclass(frozen=True, eq=False)
class HingedArm:
    """An arm of n hinges as it should be: the frame of each joint in the link before it, z its axis; rotors kg m^2; links, of one arm."""

    joint_frames: Sequence[Frame]
    armature: np.ndarray
    links: Inertials

    def inertials(self, arms: int) -> Inertials:
        """Its links, `arms` times."""
        return self.links.take([0] * arms)


def nominal_inertials(arms: int) -> Inertials:
    """The nominal arm, `arms` times."""
    mass, com, inertia = np.zeros(JOINTS), np.zeros((JOINTS, 3)), np.zeros((JOINTS, 3, 3))
    for i in range(JOINTS):
        body = NOMINAL.inertials[f"link{i + 1}"]
        mass[i], com[i], inertia[i] = body.mass, body.com, _matrix(body.inertia)
    rotation, position = _frame("link7_hand")
    bodies = [("hand", rotation, position)]
    for name in ("hand_finger1", "hand_finger2"):
        turn, shift = _frame(name)
        bodies.append(("finger", rotation @ turn, position + rotation @ shift))
    for name, turn, shift in bodies:
        body = NOMINAL.inertials[name]
        at = shift + turn @ body.com
        total = mass[6] + body.mass
        inertia[6] += turn @ _matrix(body.inertia) @ turn.T
        inertia[6] += mass[6] * body.mass / total * _spread(at - com[6])
        com[6] = (mass[6] * com[6] + body.mass * at) / total
        mass[6] = total
    repeat = [np.repeat(part[None], arms, axis=0) for part in (mass, com, inertia)]
    return Inertials(*repeat, gravity_of(arms))


def gravity_of(arms: int) -> np.ndarray:
    """(B, 3) m/s^2, on bases that stand upright."""
    return np.tile([0.0, 0.0, -GRAVITY], (arms, 1))


def tcp_in_link7() -> np.ndarray:
    """T_E (3,) m in the frame of the last link."""
    rotation, position = _frame("link7_hand")
    return position + rotation @ NOMINAL.frames["hand_tcp"].position


class RigidArms:
    """Mass matrix, velocity and gravity torques of B arms with these inertials; joint_frames: as of `HingedArm`."""

    def __init__(self, inertials: Inertials, joint_frames: Sequence[Frame] = NOMINAL.joint_frames):
        self.inertials = inertials
        frames = [(matrix_from_quaternion(f.quaternion), f.position) for f in joint_frames]
        self._upper = np.triu(np.ones((len(frames), len(frames)), dtype=bool))
        self._turns, self._shifts = (np.array(part) for part in zip(*frames))
        # Rotation carries the second moment of mass, S = tr(I)/2 - I, by one product: (R s)(R s)^T.
        moment = 0.5 * np.trace(inertials.inertia, axis1=2, axis2=3)[..., None, None] * np.eye(3)
        self._moment = moment - inertials.inertia
        self._gravity = np.repeat(-inertials.gravity.T[:, :, None], len(frames), axis=2)

    def terms(self, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(mass matrix (B, 7, 7) without rotors, velocity torque (B, 7), torque against gravity (B, 7)).

        q (B, 7) rad, dq (B, 7) rad/s; kg m^2 and Nm.
        """
        rotations, origins = self._chain(q)
        screw = np.empty((3, 2, *q.shape))  # of each joint: axis, and velocity that it gives the base's origin
        screw[:, 0] = axis = _component_first(rotations[:, :, :, 2])
        screw[:, 1] = lever = _cross(origins, axis)
        mass = self.inertials.mass
        com = origins + _component_first(np.matmul(rotations, self.inertials.com[..., None])[..., 0])
        # Mass, its first and second moments about the base's origin, in rows of one array.
        moments = np.empty((13, *q.shape))
        moments[0] = mass
        first, second = moments[1:4], moments[4:].reshape(3, 3, *q.shape)
        np.multiply(mass, com, out=first)
        turned = np.matmul(np.matmul(rotations, self._moment), rotations.transpose(0, 1, 3, 2))
        np.add(turned.transpose(2, 3, 0, 1), first[:, None] * com, out=second)

        # Mass matrix: the momentum that each joint gives to the links beyond it.
        beyond = _beyond(moments)
        first_sum = beyond[1:4]
        wrench = _momentum(beyond[0], first_sum, beyond[4:].reshape(3, 3, *q.shape), screw[:, 0], screw[:, 1])
        matrix = np.einsum("xsbi,xsbk->bik", screw, wrench)
        matrix = np.where(self._upper, matrix, matrix.transpose(0, 2, 1))

        # Velocities and accelerations for standing targets (qdd = 0), and the forces that they take.
        motion = np.empty((3, 2, 2, *q.shape))  # angular and linear; velocity and acceleration
        np.cumsum(screw * dq, axis=3, out=motion[:, :, 0])
        spin, sweep = motion[:, 0, 0], motion[:, 1, 0]
        change = _cross(spin, screw)
        change[:, 1] += _cross(sweep, axis)
        np.cumsum(change * dq, axis=3, out=motion[:, :, 1])
        momentum = _momentum(mass, first, second, motion[:, 0], motion[:, 1])
        force = momentum[:, :, 1] + _cross(spin, momentum[:, :, 0])
        force[:, 0] += _cross(sweep, momentum[:, 1, 0])
        velocity = (screw * _beyond(force)).sum(axis=(0, 1))

        weight = (axis * _cross(first_sum, self._gravity) + lever * (beyond[0] * self._gravity)).sum(axis=0)
        return matrix, velocity, weight

    def _chain(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotations (B, 7, 3, 3) and origins (3, B, 7) of the links in the base frame."""
        cosine, sine = np.cos(q)[:, :, None], np.sin(q)[:, :, None]
        own = np.empty((*q.shape, 3, 3))  # of each link in the one before it
        own[..., 0] = cosine * self._turns[:, :, 0] + sine * self._turns[:, :, 1]
        own[..., 1] = cosine * self._turns[:, :, 1] - sine * self._turns[:, :, 0]
        own[..., 2] = self._turns[:, :, 2]
        rotations = np.empty((len(q), q.shape[1] + 1, 3, 3))
        rotations[:, 0] = _UNIT
        for i in range(q.shape[1]):
            np.matmul(rotations[:, i], own[:, i], out=rotations[:, i + 1])
        steps = np.matmul(rotations[:, :-1], self._shifts[:, :, None])[..., 0]
        return rotations[:, 1:], np.cumsum(_component_first(steps), axis=2)


def _momentum(
    mass: np.ndarray, first: np.ndarray, second: np.ndarray, angular: np.ndarray, linear: np.ndarray
) -> np.ndarray:
    """Momentum (3, 2, ...), angular then linear, about the base's origin, of bodies with these moments of
    mass that move with `angular` (3, ...) rad/s and `linear` m/s of that origin."""
    momentum = np.empty((3, 2, *angular.shape[1:]))
    trace = second[0, 0] + second[1, 1] + second[2, 2]
    momentum[:, 0] = trace * angular - _apply(second, angular) + _cross(first, linear)
    momentum[:, 1] = mass * linear - _cross(first, angular)
    return momentum


def _beyond(values: np.ndarray) -> np.ndarray:
    """Sum over a link and all links further out."""
    return np.cumsum(values[..., ::-1], axis=-1)[..., ::-1]


def _component_first(vectors: np.ndarray) -> np.ndarray:
    """(B, 7, 3) as (3, B, 7)."""
    return np.ascontiguousarray(vectors.transpose(2, 0, 1))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of (3, B, 7) with (3, ..., B, 7)."""
    a = np.concatenate([a, a[:2]])
    a = a.reshape(5, *(1,) * (b.ndim - a.ndim), *a.shape[1:])
    b = np.concatenate([b, b[:2]])
    return a[1:4] * b[2:5] - a[2:5] * b[1:4]


def _apply(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Symmetric (3, 3, B, 7) on (3, ..., B, 7)."""
    matrix = matrix.reshape(3, 3, *(1,) * (vector.ndim - 3), *matrix.shape[2:])
    return matrix[0] * vector[0] + matrix[1] * vector[1] + matrix[2] * vector[2]


def _spread(offset: np.ndarray) -> np.ndarray:
    """Inertia (3, 3) of a unit mass at an offset (3,)."""
    return offset @ offset * np.eye(3) - np.outer(offset, offset)


def _matrix(six: np.ndarray) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _frame(name: str) -> tuple[np.ndarray, np.ndarray]:
    frame = NOMINAL.frames[name]
    return matrix_from_quaternion(frame.quaternion), frame.position


PANDA = HingedArm(tuple(NOMINAL.joint_frames), NOMINAL.armature, nominal_inertials(1))
