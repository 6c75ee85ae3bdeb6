"""The arm as a chain of joints in Warp, for kernels that take a thread a row or a world.

What np_control.kinematics works out for arrays, here for one posture at a time. Kernels that use it lie in files of their
own because Warp compiles by file: their loops over 7 x 7 matrices are not unrolled.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import warp as wp

from np_common.rotations import xyzw_from_wxyz
from np_description.panda import NOMINAL

wp.set_module_options({"max_unroll": 1, "enable_backward": False})

mat6 = wp.types.matrix(shape=(6, 6), dtype=float)
mat67 = wp.types.matrix(shape=(6, 7), dtype=float)
vec7 = wp.types.vector(length=7, dtype=float)
vec6 = wp.types.vector(length=6, dtype=float)


@wp.struct
class KinematicChain:
    """Fixed transforms (9,), link to link, then hand and T_E; position_lower, position_upper (7,) rad."""

    position: wp.array(dtype=wp.vec3)
    rotation: wp.array(dtype=wp.quat)
    position_lower: vec7
    position_upper: vec7


@cache
def make_chain(device: str) -> KinematicChain:
    """The arm for kernels on a device."""
    frames = [*NOMINAL.joint_frames, NOMINAL.frames["link7_hand"], NOMINAL.frames["hand_tcp"]]
    chain = KinematicChain()
    chain.position = wp.array([f.position for f in frames], dtype=wp.vec3, device=device)
    chain.rotation = wp.array([xyzw_from_wxyz(f.quaternion) for f in frames], dtype=wp.quat, device=device)
    chain.position_lower = vec7(*map(float, NOMINAL.position_lower))
    chain.position_upper = vec7(*map(float, NOMINAL.position_upper))
    return chain


@wp.func
def joint_frames(chain: KinematicChain, q: vec7):
    """Position and rotation of T_E at joints q; origins of the joints, then their axes (6 x 7), in the base frame."""
    at = wp.vec3(0.0, 0.0, 0.0)
    turned = wp.quat_identity()
    joints = mat67()
    for j in range(9):
        at = at + wp.quat_rotate(turned, chain.position[j])
        turned = turned * chain.rotation[j]
        if j < 7:
            turned = turned * wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), q[j])
            axis = wp.quat_rotate(turned, wp.vec3(0.0, 0.0, 1.0))
            for k in range(3):
                joints[k, j] = at[k]
                joints[k + 3, j] = axis[k]
    return at, turned, joints


@wp.func
def jacobian(at: wp.vec3, joints: mat67):
    """Geometric Jacobian (6 x 7) of a point at `at`, base frame: rows linear, then angular; joints as `joint_frames` has
    them."""
    jac = mat67()
    for j in range(7):
        axis = wp.vec3(joints[3, j], joints[4, j], joints[5, j])
        linear = wp.cross(axis, at - wp.vec3(joints[0, j], joints[1, j], joints[2, j]))
        for k in range(3):
            jac[k, j] = linear[k]
            jac[k + 3, j] = axis[k]
    return jac


@wp.func
def posture(q: wp.array2d(dtype=float), i: int):
    """Joints (7,) of row i."""
    joints = vec7()
    for j in range(7):
        joints[j] = q[i, j]
    return joints


@wp.func
def times_transposed(a: mat67, b: mat67):
    """a b' (6 x 6)."""
    product = mat6()
    for k in range(6):
        for m in range(6):
            entry = float(0.0)
            for j in range(7):
                entry = entry + a[k, j] * b[m, j]
            product[k, m] = entry
    return product


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
