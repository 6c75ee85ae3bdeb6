"""Kinematics of many postures at once on the simulator's device: np_control.kinematics, one thread a row.

Written out in PyTorch an inverse kinematics is some four hundred small kernels, most of what a policy period then costs
beside its physics; here it is one. Tests hold both to the same result.
"""

from __future__ import annotations

import torch
import warp as wp

from np_control.kinematics import IK_DAMPING, IK_ITERATIONS
from np_training.physics.chain import (
    KinematicChain,
    cholesky,
    cholesky_solve,
    jacobian,
    joint_frames,
    make_chain,
    posture,
    rotation_vector,
    times_transposed,
    vec6,
)

wp.set_module_options({"max_unroll": 1, "enable_backward": False})


@wp.kernel
def forward_kernel(
    chain: KinematicChain,
    q: wp.array2d(dtype=float),
    position: wp.array(dtype=wp.vec3),
    rotation: wp.array(dtype=wp.mat33),
):
    """Pose of T_E for row i."""
    i = wp.tid()
    at, turned, frames = joint_frames(chain, posture(q, i))
    position[i] = at
    rotation[i] = wp.quat_to_matrix(turned)


@wp.kernel
def inverse_kernel(
    chain: KinematicChain,
    iterations: int,
    damping: float,
    q: wp.array2d(dtype=float),
    position: wp.array(dtype=wp.vec3),
    rotation: wp.array(dtype=wp.mat33),
    solution: wp.array2d(dtype=float),
):
    """np_control.kinematics.solve_ik for row i."""
    i = wp.tid()
    joints = posture(q, i)
    wanted = wp.quat_from_matrix(rotation[i])
    for _ in range(iterations):
        at, turned, frames = joint_frames(chain, joints)
        jac = jacobian(at, frames)
        shift = position[i] - at
        turn = rotation_vector(wanted * wp.quat_inverse(turned))
        error = vec6()
        for k in range(3):
            error[k] = shift[k]
            error[k + 3] = turn[k]
        product = times_transposed(jac, jac)
        for k in range(6):
            product[k, k] = product[k, k] + damping * damping
        error = cholesky_solve(cholesky(product, 6), error, 6)
        for j in range(7):
            step = float(0.0)
            for k in range(6):
                step = step + jac[k, j] * error[k]
            joints[j] = wp.clamp(joints[j] + step, chain.position_lower[j], chain.position_upper[j])
    for j in range(7):
        solution[i, j] = joints[j]


def forward_kinematics(q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Position (n, 3) m and rotation (n, 3, 3) of T_E in the base frame, for joints q (n, 7) rad, single precision."""
    position, rotation = q.new_empty(len(q), 3), q.new_empty(len(q), 3, 3)
    _launch(forward_kernel, q, [q], [position, rotation])
    return position, rotation


def solve_ik(
    q: torch.Tensor,
    position: torch.Tensor,
    rotation: torch.Tensor,
    *,
    iterations: int = IK_ITERATIONS,
    damping: float = IK_DAMPING,
) -> torch.Tensor:
    """Joints (n, 7) rad near q (n, 7) that bring T_E to position (n, 3) m and rotation (n, 3, 3), single precision; as
    np_control.kinematics.solve_ik."""
    solution = torch.empty_like(q, memory_format=torch.contiguous_format)
    _launch(inverse_kernel, q, [iterations, damping, q, position, rotation], [solution])
    return solution


def _launch(kernel: wp.Kernel, like: torch.Tensor, inputs: list, outputs: list[torch.Tensor]) -> None:
    """Run a kernel of the chain, a thread a row of `like`, where and when PyTorch would run it."""
    if not len(like):
        return
    device = wp.get_device(str(like.device))
    stream = None
    if device.is_cuda:
        current = torch.cuda.current_stream(like.device)
        # Warp drops its own stream when a second wrapper of it, made from PyTorch's, is destroyed.
        if current.cuda_stream != device.stream.cuda_stream:
            stream = wp.stream_from_torch(current)
    dtypes = {2: None, 3: wp.mat33}

    def array(value):
        if not isinstance(value, torch.Tensor):
            return value
        dtype = wp.vec3 if value.shape[1:] == (3,) else dtypes[value.ndim]
        return wp.from_torch(value if value.ndim == 2 else value.contiguous(), dtype=dtype, requires_grad=False)

    wp.launch(
        kernel,
        dim=len(like),
        inputs=[make_chain(device.alias), *map(array, inputs)],
        outputs=list(map(array, outputs)),
        device=device,
        stream=stream,
    )
