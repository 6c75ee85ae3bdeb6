"""Operational-space control in the batched simulator: np_control.operational_space, one thread a world.

A kernel in a file of its own: see np_training.physics.chain.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from np_control.operational_space import POSTURE, REGULARISATION
from np_training.physics.chain import (
    Chain,
    cholesky,
    cholesky_solve,
    jacobian,
    joint_frames,
    mat7,
    mat67,
    posture,
    rotation_vector,
    times_transposed,
    vec6,
    vec7,
)

wp.set_module_options({"max_unroll": 1, "enable_backward": False})


@wp.struct
class Gains:
    """What of the law nobody chooses, and row: where each joint's row, columns 0 to j, begins in the simulator's mass matrix."""

    row: wp.array(dtype=int)
    posture: float
    regularisation: float


def make_gains(rows: np.ndarray, device: wp.Device) -> Gains:
    """The gains for the kernel. rows (7,): first element of each joint's row of the mass matrix."""
    gains = Gains()
    gains.row = wp.array(rows, dtype=int, device=device)
    gains.posture, gains.regularisation = POSTURE, REGULARISATION
    return gains


@wp.func
def watch_share(
    substep: int,
    kind: int,
    i: int,
    j: int,
    share: float,
    margin: float,
    over: wp.array3d(dtype=int),
    peak: wp.array3d(dtype=float),
):
    """Note the share of a limit that joint j of world i takes in a substep: the largest, and how often it is beyond `margin`.
    The first substep begins anew."""
    if substep == 0:
        over[kind, i, j] = 0
        peak[kind, i, j] = 0.0
    peak[kind, i, j] = wp.max(peak[kind, i, j], share)
    if share > margin:
        over[kind, i, j] = over[kind, i, j] + 1


@wp.kernel
def operational_space_kernel(
    substep: int,
    chain: Chain,
    gains: Gains,
    limit: wp.array2d(dtype=float),
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    bias: wp.array2d(dtype=float),
    gravity: wp.array2d(dtype=float),
    mass: wp.array2d(dtype=float),
    command: wp.array3d(dtype=float),
    delay: wp.array(dtype=int),
    noise: wp.array2d(dtype=float),
    margin: wp.array(dtype=float),
    ctrl: wp.array2d(dtype=float),
    over: wp.array3d(dtype=int),
    peak: wp.array3d(dtype=float),
):
    """np_control.operational_space_torque for world i; a test holds both to the same result.

    command (6, worlds, 7): posture, T_E as position and quaternion (scalar last), and `chosen_gains`,
    of the last period, then of this one, which takes effect after `delay` substeps. limit, margin, over, peak: see
    `physics.impedance_kernel`.
    """
    i = wp.tid()
    new = 0
    if substep >= delay[i]:
        new = 3

    at, turned, joints = joint_frames(chain, posture(qpos, i))
    jac = jacobian(at, joints)

    # Acceleration that is asked of T_E.
    target = wp.vec3(command[new + 1, i, 0], command[new + 1, i, 1], command[new + 1, i, 2])
    wanted = wp.quat(command[new + 1, i, 3], command[new + 1, i, 4], command[new + 1, i, 5], command[new + 1, i, 6])
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
        stiffness = command[new + 2, i, k]
        force[k] = stiffness * error - 2.0 * command[new + 2, i, 6] * wp.sqrt(stiffness) * speed

    # M and what it makes of the pull towards the posture.
    inertia = mat7()
    for j in range(7):
        for k in range(j + 1):
            inertia[j, k] = mass[i, gains.row[j] + k]
            inertia[k, j] = mass[i, gains.row[j] + k]
    inner = vec7()
    for j in range(7):
        total = float(0.0)
        for k in range(7):
            pull = gains.posture * (command[new, i, k] - qpos[i, k])
            pull = pull - 2.0 * wp.sqrt(gains.posture) * qvel[i, k]
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
    product = times_transposed(jac, mobility)
    for k in range(6):
        product[k, k] = product[k, k] + gains.regularisation

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
        watch_share(substep, 0, i, j, wp.abs(qvel[i, j]) / limit[0, j], margin[i], over, peak)
        watch_share(substep, 1, i, j, wp.abs(torque) / limit[1, j], 1.0, over, peak)
        most = margin[i] * limit[1, j]
        ctrl[i, j] = wp.clamp(torque, -most, most)
