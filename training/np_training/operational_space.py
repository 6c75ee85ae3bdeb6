"""Operational-space control in the batched simulator: np_control.operational_space, one thread a world.

A kernel in a file of its own because Warp compiles by file: loops over 7 x 7 matrices are not unrolled here.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from np_control.operational_space import REGULARISATION, CartesianGains
from np_description.panda import NOMINAL, PandaModel
from np_description.rotations import xyzw_from_wxyz

wp.set_module_options({"max_unroll": 1, "enable_backward": False})

mat7 = wp.types.matrix(shape=(7, 7), dtype=float)
mat6 = wp.types.matrix(shape=(6, 6), dtype=float)
mat67 = wp.types.matrix(shape=(6, 7), dtype=float)
vec7 = wp.types.vector(length=7, dtype=float)
vec6 = wp.types.vector(length=6, dtype=float)


@wp.struct
class Chain:
    """The arm's fixed transforms, link to link, then hand and T_E, and the gains."""

    position: wp.array(dtype=wp.vec3)
    rotation: wp.array(dtype=wp.quat)
    row: wp.array(dtype=int)  # where the row of a joint begins in the simulator's mass matrix
    stiffness: vec6
    posture: float
    damping_ratio: float
    regularisation: float


def make_chain(
    rows: np.ndarray, device: wp.Device, gains: CartesianGains = CartesianGains(), panda: PandaModel = NOMINAL
) -> Chain:
    """The arm for the kernel. rows (7,): first element of each joint's row, columns 0 to j, of the mass
    matrix."""
    frames = [*panda.joint_frames, panda.frames["link7_hand"], panda.frames["hand_tcp"]]
    chain = Chain()
    chain.position = wp.array([f.position for f in frames], dtype=wp.vec3, device=device)
    chain.rotation = wp.array([xyzw_from_wxyz(f.quaternion) for f in frames], dtype=wp.quat, device=device)
    chain.row = wp.array(rows, dtype=int, device=device)
    chain.stiffness = vec6(*np.repeat([gains.position, gains.rotation], 3).tolist())
    chain.posture, chain.damping_ratio = gains.posture, gains.damping_ratio
    chain.regularisation = REGULARISATION
    return chain


@wp.func
def count_excess(
    substep: int,
    kind: int,
    i: int,
    j: int,
    value: float,
    limit: wp.array2d(dtype=float),
    over: wp.array3d(dtype=int),
):
    """Count a substep of joint j in world i whose value is beyond its limit; the first begins anew."""
    if substep == 0:
        over[kind, i, j] = 0
    if wp.abs(value) > limit[kind, j]:
        over[kind, i, j] = over[kind, i, j] + 1


@wp.func
def rotation_vector(turn: wp.quat):
    """Axis times angle in [0, pi] of a unit quaternion."""
    imaginary = wp.vec3(turn[0], turn[1], turn[2])
    real = turn[3]
    if real < 0.0:
        imaginary = -imaginary
        real = -real
    sine = wp.length(imaginary)
    scale = float(2.0)
    if sine > 1.0e-7:
        scale = 2.0 * wp.atan2(sine, real) / sine
    return scale * imaginary


@wp.func
def cholesky(a: Any, size: int):
    """Lower factor of a positive definite matrix (size, size)."""
    for j in range(size):
        for k in range(j):
            for i in range(j, size):
                a[i, j] = a[i, j] - a[i, k] * a[j, k]
        pivot = wp.sqrt(wp.max(a[j, j], 1.0e-9))
        for i in range(j, size):
            a[i, j] = a[i, j] / pivot
    return a


@wp.func
def cholesky_solve(lower: Any, right: Any, size: int):
    """x (size,) with L L' x = right, for a lower factor L (size, size)."""
    for j in range(size):
        rest = right[j]
        for k in range(j):
            rest = rest - lower[j, k] * right[k]
        right[j] = rest / lower[j, j]
    for back in range(size):
        j = size - 1 - back
        rest = right[j]
        for k in range(j + 1, size):
            rest = rest - lower[k, j] * right[k]
        right[j] = rest / lower[j, j]
    return right


@wp.kernel
def operational_space_kernel(
    substep: int,
    chain: Chain,
    limit: wp.array2d(dtype=float),
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    bias: wp.array2d(dtype=float),
    gravity: wp.array2d(dtype=float),
    mass: wp.array2d(dtype=float),
    command: wp.array3d(dtype=float),
    delay: wp.array(dtype=int),
    noise: wp.array2d(dtype=float),
    ctrl: wp.array2d(dtype=float),
    over: wp.array3d(dtype=int),
):
    """np_control.operational_space_torque for world i; a test holds both to the same result.

    command (6, worlds, 7): posture, T_E as position and quaternion (scalar last), and a row that is not used,
    of the last period, then of this one, which takes effect after `delay` substeps. limit, over: see
    `physics.impedance_kernel`.
    """
    i = wp.tid()
    new = 0
    if substep >= delay[i]:
        new = 3

    # Pose of T_E and its Jacobian (6 x 7) in the base frame.
    at = wp.vec3(0.0, 0.0, 0.0)
    turned = wp.quat_identity()
    origins = mat67()
    for j in range(9):
        at = at + wp.quat_rotate(turned, chain.position[j])
        turned = turned * chain.rotation[j]
        if j < 7:
            turned = turned * wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), qpos[i, j])
            axis = wp.quat_rotate(turned, wp.vec3(0.0, 0.0, 1.0))
            for k in range(3):
                origins[k, j] = at[k]
                origins[k + 3, j] = axis[k]
    jac = mat67()
    for j in range(7):
        axis = wp.vec3(origins[3, j], origins[4, j], origins[5, j])
        linear = wp.cross(axis, at - wp.vec3(origins[0, j], origins[1, j], origins[2, j]))
        for k in range(3):
            jac[k, j] = linear[k]
            jac[k + 3, j] = axis[k]

    # Acceleration that is asked of T_E.
    target = wp.vec3(command[new + 1, i, 0], command[new + 1, i, 1], command[new + 1, i, 2])
    wanted = wp.quat(
        command[new + 1, i, 3], command[new + 1, i, 4], command[new + 1, i, 5], command[new + 1, i, 6]
    )
    shift = target - at
    turn = rotation_vector(wanted * wp.quat_inverse(turned))
    force = vec6()
    for k in range(6):
        speed = float(0.0)
        for j in range(7):
            speed = speed + jac[k, j] * qvel[i, j]
        error = float(0.0)
        if k < 3:
            error = shift[k]
        else:
            error = turn[k - 3]
        force[k] = (
            chain.stiffness[k] * error - 2.0 * chain.damping_ratio * wp.sqrt(chain.stiffness[k]) * speed
        )

    # M and what it makes of the pull towards the posture.
    inertia = mat7()
    for j in range(7):
        for k in range(j + 1):
            inertia[j, k] = mass[i, chain.row[j] + k]
            inertia[k, j] = mass[i, chain.row[j] + k]
    inner = vec7()
    for j in range(7):
        total = float(0.0)
        for k in range(7):
            pull = chain.posture * (command[new, i, k] - qpos[i, k])
            pull = pull - 2.0 * chain.damping_ratio * wp.sqrt(chain.posture) * qvel[i, k]
            total = total + inertia[j, k] * pull
        inner[j] = total

    # mobility = M^-1 J', one column a direction; then J mobility.
    lower = cholesky(inertia, 7)
    mobility = mat67()  # transposed
    for k in range(6):
        column = vec7()
        for j in range(7):
            column[j] = jac[k, j]
        column = cholesky_solve(lower, column, 7)
        for j in range(7):
            mobility[k, j] = column[j]
    product = mat6()
    for k in range(6):
        for m in range(6):
            entry = float(0.0)
            for j in range(7):
                entry = entry + jac[k, j] * mobility[m, j]
            product[k, m] = entry
        product[k, k] = product[k, k] + chain.regularisation

    # Both uses of Lambda in one solution: J' Lambda (force - mobility' inner).
    for k in range(6):
        moved = float(0.0)
        for j in range(7):
            moved = moved + mobility[k, j] * inner[j]
        force[k] = force[k] - moved
    force = cholesky_solve(cholesky(product, 6), force, 6)
    for j in range(7):
        torque = inner[j] + bias[i, j] - gravity[i, j] + noise[i, j]
        for k in range(6):
            torque = torque + jac[k, j] * force[k]
        count_excess(substep, 0, i, j, qvel[i, j], limit, over)
        count_excess(substep, 1, i, j, torque, limit, over)
        ctrl[i, j] = wp.clamp(torque, -limit[1, j], limit[1, j])
