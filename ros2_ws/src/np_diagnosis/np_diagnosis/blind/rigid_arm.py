"""Rigid-body dynamics of many arms at once, in world coordinates.

Spatial vectors are taken about the origin of the base, so that inertias, velocities and forces of links just
add up along the chain (Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 2 and 6): sums over the
links are cumulative sums, and only the rotations need a loop. Arrays are (3, B, 7): component, arm, link.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_description.panda import NOMINAL, PandaModel
from np_description.rotations import matrix_from_quaternion

JOINTS = 7
GRAVITY = 9.81
_UPPER = np.triu(np.ones((JOINTS, JOINTS), dtype=bool))


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
        return Inertials(*(np.concatenate([getattr(self, name), getattr(other, name)])
                           for name in ("mass", "com", "inertia", "gravity")))

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


def nominal_inertials(arms: int, panda: PandaModel = NOMINAL) -> Inertials:
    """The nominal arm, `arms` times."""
    mass, com, inertia = np.zeros(JOINTS), np.zeros((JOINTS, 3)), np.zeros((JOINTS, 3, 3))
    for i in range(JOINTS):
        body = panda.inertials[f"link{i + 1}"]
        mass[i], com[i], inertia[i] = body.mass, body.com, _matrix(body.inertia)
    rotation, position = _frame(panda, "link7_hand")
    bodies = [("hand", rotation, position)]
    for name in ("hand_finger1", "hand_finger2"):
        turn, shift = _frame(panda, name)
        bodies.append(("finger", rotation @ turn, position + rotation @ shift))
    for name, turn, shift in bodies:
        body = panda.inertials[name]
        at = shift + turn @ body.com
        total = mass[6] + body.mass
        inertia[6] += turn @ _matrix(body.inertia) @ turn.T
        inertia[6] += mass[6] * body.mass / total * _spread(at - com[6])
        com[6] = (mass[6] * com[6] + body.mass * at) / total
        mass[6] = total
    repeat = [np.repeat(part[None], arms, axis=0) for part in (mass, com, inertia)]
    return Inertials(*repeat, np.tile([0.0, 0.0, -GRAVITY], (arms, 1)))


def tcp_in_link7(panda: PandaModel = NOMINAL) -> np.ndarray:
    """T_E (3,) m in the frame of the last link."""
    rotation, position = _frame(panda, "link7_hand")
    return position + rotation @ panda.frames["hand_tcp"].position


class RigidArms:
    """Mass matrix, velocity and gravity torques of B arms with these inertials."""

    def __init__(self, inertials: Inertials, panda: PandaModel = NOMINAL):
        self.inertials = inertials
        frames = [(matrix_from_quaternion(f.quaternion), f.position) for f in panda.joint_frames]
        self._turns, self._shifts = zip(*frames)
        # Rotation carries the second moment of mass, S = tr(I)/2 - I, by one product: (R s)(R s)^T.
        moment = 0.5 * np.trace(inertials.inertia, axis1=2, axis2=3)[..., None, None] * np.eye(3)
        self._moment = moment - inertials.inertia
        self._gravity = -inertials.gravity.T[:, :, None]

    def terms(self, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(mass matrix (B, 7, 7) without rotors, velocity torque (B, 7), torque against gravity (B, 7)).

        q (B, 7) rad, dq (B, 7) rad/s; kg m^2 and Nm.
        """
        rotations, origins = self._chain(q)
        axis = _component_first(rotations[:, :, :, 2])
        lever = _cross(origins, axis)
        mass = self.inertials.mass
        com = origins + _component_first(np.matmul(rotations, self.inertials.com[..., None])[..., 0])
        first = mass * com
        # Second moment about the base's origin, and from it the inertia there.
        second = np.matmul(np.matmul(rotations, self._moment), rotations.transpose(0, 1, 3, 2))
        second = np.ascontiguousarray(second.transpose(2, 3, 0, 1)) + first[:, None] * com[None]
        trace = second[0, 0] + second[1, 1] + second[2, 2]

        # Mass matrix: the momentum that each joint gives to the links beyond it.
        mass_sum, first_sum, second_sum = (_beyond(part) for part in (mass, first, second))
        trace_sum = _beyond(trace)
        turn = trace_sum * axis - _apply(second_sum, axis) + _cross(first_sum, lever)
        push = mass_sum * lever - _cross(first_sum, axis)
        matrix = np.einsum("xbi,xbk->bik", axis, turn) + np.einsum("xbi,xbk->bik", lever, push)
        matrix = np.where(_UPPER, matrix, matrix.transpose(0, 2, 1))

        # Velocities and accelerations for standing targets (qdd = 0), and the forces that they take.
        spin, sweep = np.cumsum(axis * dq, axis=2), np.cumsum(lever * dq, axis=2)
        turning = np.cumsum(_cross(spin, axis) * dq, axis=2)
        moving = np.cumsum((_cross(spin, lever) + _cross(sweep, axis)) * dq, axis=2)
        angular = trace * spin - _apply(second, spin) + _cross(first, sweep)
        linear = mass * sweep - _cross(first, spin)
        torque = trace * turning - _apply(second, turning) + _cross(first, moving)
        torque += _cross(spin, angular) + _cross(sweep, linear)
        force = mass * moving - _cross(first, turning) + _cross(spin, linear)
        velocity = (axis * _beyond(torque) + lever * _beyond(force)).sum(axis=0)

        held = np.empty_like(axis)
        held[:] = self._gravity
        weight = (axis * _cross(first_sum, held) + lever * (mass_sum * held)).sum(axis=0)
        return matrix, velocity, weight

    def _chain(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotations (B, 7, 3, 3) and origins (3, B, 7) of the links in the base frame."""
        arms = len(q)
        cosine, sine = np.cos(q), np.sin(q)
        rotations, origins = np.empty((arms, JOINTS, 3, 3)), np.empty((3, arms, JOINTS))
        rotation, origin = np.broadcast_to(np.eye(3), (arms, 3, 3)), np.zeros((arms, 3))
        for i in range(JOINTS):
            flat = rotation.reshape(-1, 3)
            origin = origin + (flat @ self._shifts[i]).reshape(arms, 3)
            fixed = (flat @ self._turns[i]).reshape(arms, 3, 3)
            c, s = cosine[:, i, None], sine[:, i, None]
            rotation = np.empty_like(fixed)
            rotation[:, :, 0] = c * fixed[:, :, 0] + s * fixed[:, :, 1]
            rotation[:, :, 1] = c * fixed[:, :, 1] - s * fixed[:, :, 0]
            rotation[:, :, 2] = fixed[:, :, 2]
            rotations[:, i], origins[:, :, i] = rotation, origin.T
        return rotations, origins


def _beyond(values: np.ndarray) -> np.ndarray:
    """Sum over a link and all links further out."""
    return np.cumsum(values[..., ::-1], axis=-1)[..., ::-1]


def _component_first(vectors: np.ndarray) -> np.ndarray:
    """(B, 7, 3) as (3, B, 7)."""
    return np.ascontiguousarray(vectors.transpose(2, 0, 1))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for x, y, z in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[y], b[z], out=product[x])
        product[x] -= a[z] * b[y]
    return product


def _apply(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Symmetric (3, 3, B, 7) on (3, B, 7)."""
    return matrix[0] * vector[0] + matrix[1] * vector[1] + matrix[2] * vector[2]


def _spread(offset: np.ndarray) -> np.ndarray:
    """Inertia (3, 3) of a unit mass at an offset (3,)."""
    return offset @ offset * np.eye(3) - np.outer(offset, offset)


def _matrix(six: np.ndarray) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _frame(panda: PandaModel, name: str) -> tuple[np.ndarray, np.ndarray]:
    frame = panda.frames[name]
    return matrix_from_quaternion(frame.quaternion), frame.position
