"""The torque that holds many arms against gravity: sim2real.effects.gravity.GravityTorque, one thread a posture."""

from __future__ import annotations

import numpy as np
import torch
import warp as wp

from np_common.rotations import matrix_from_quaternion
from np_description.panda import NOMINAL, PandaModel
from np_training.physics.chain import KinematicChain, make_chain, posture, vec7

wp.set_module_options({"max_unroll": 1, "enable_backward": False})

GRAVITY = 9.81  # m/s^2
mat73 = wp.types.matrix(shape=(7, 3), dtype=float)


@wp.kernel
def hold_kernel(
    chain: KinematicChain,
    mass: vec7,
    com: mat73,
    gravity: wp.vec3,
    q: wp.array2d(dtype=float),
    torque: wp.array2d(dtype=float),
):
    """Torque of row i. mass, com: of the link that each joint moves, with all that is fixed to it, in its own frame."""
    i = wp.tid()
    angles = posture(q, i)
    at = wp.vec3(0.0, 0.0, 0.0)
    turned = wp.quat_identity()
    origin = mat73()
    axis = mat73()
    weight = mat73()  # centres of mass in the base frame
    for j in range(7):
        at = at + wp.quat_rotate(turned, chain.position[j])
        turned = turned * chain.rotation[j] * wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), angles[j])
        z = wp.quat_rotate(turned, wp.vec3(0.0, 0.0, 1.0))
        centre = at + wp.quat_rotate(turned, wp.vec3(com[j, 0], com[j, 1], com[j, 2]))
        for k in range(3):
            origin[j, k] = at[k]
            axis[j, k] = z[k]
            weight[j, k] = centre[k]
    for j in range(7):
        z = wp.vec3(axis[j, 0], axis[j, 1], axis[j, 2])
        begin = wp.vec3(origin[j, 0], origin[j, 1], origin[j, 2])
        total = float(0.0)
        for b in range(j, 7):
            centre = wp.vec3(weight[b, 0], weight[b, 1], weight[b, 2])
            total = total - mass[b] * wp.dot(wp.cross(z, centre - begin), gravity)
        torque[i, j] = total


class BatchedHold:
    """Torque (n, 7) Nm that holds an arm at joints (n, 7) rad, closed fingers. tilt: (roll, pitch) rad of the base."""

    def __init__(self, device: str, panda: PandaModel = NOMINAL, tilt: tuple[float, float] = (0.0, 0.0)) -> None:
        self._device = wp.get_device(str(device))
        mass, com = _links(panda)
        self._mass, self._com = vec7(*mass.tolist()), mat73(*com.flatten().tolist())
        self._gravity = wp.vec3(GRAVITY * tilt[1], -GRAVITY * tilt[0], -GRAVITY)

    def __call__(self, q: torch.Tensor) -> torch.Tensor:
        """See the class."""
        q = q.contiguous()
        torque = torch.empty_like(q)
        wp.launch(
            hold_kernel,
            dim=len(q),
            inputs=[make_chain(self._device.alias), self._mass, self._com, self._gravity, wp.from_torch(q)],
            outputs=[wp.from_torch(torque)],
            device=self._device,
        )
        return torque


def _links(panda: PandaModel) -> tuple[np.ndarray, np.ndarray]:
    """Mass (7,) kg and centre of mass (7, 3) m in its own frame of what each joint moves rigidly: hand and fingers with link 7."""
    mass = np.array([panda.inertials[f"link{j + 1}"].mass for j in range(7)])
    com = np.array([panda.inertials[f"link{j + 1}"].com for j in range(7)])
    hand, tip = panda.frames["link7_hand"], panda.inertials["finger"]
    parts = [(mass[6], com[6]), (panda.inertials["hand"].mass, _in_parent(hand, panda.inertials["hand"].com))]
    for number in (1, 2):
        parts.append((tip.mass, _in_parent(hand, _in_parent(panda.frames[f"hand_finger{number}"], tip.com))))
    mass[6] = sum(m for m, _ in parts)
    com[6] = sum(m * c for m, c in parts) / mass[6]
    return mass, com


def _in_parent(frame, point: np.ndarray) -> np.ndarray:
    return frame.position + matrix_from_quaternion(frame.quaternion) @ point
