"""The joint impedance law in every world: np_control.impedance as a kernel of Warp."""

from __future__ import annotations

import warp as wp


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
def impedance_kernel(
    substep: int,
    limit: wp.array2d(dtype=float),
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    bias: wp.array2d(dtype=float),
    gravity: wp.array2d(dtype=float),
    command: wp.array3d(dtype=float),
    delay: wp.array(dtype=int),
    noise: wp.array2d(dtype=float),
    margin: wp.array(dtype=float),
    ctrl: wp.array2d(dtype=float),
    over: wp.array3d(dtype=int),
    peak: wp.array3d(dtype=float),
):
    """np_control.impedance.torque for joint j of world i; a test holds both to the same result.

    command (6, worlds, 7): joint target, stiffness, damping ratio of the last period, then of this one, which
    takes effect after `delay` substeps. limit (2, 7): of velocity and torque; margin (worlds,): share of them that is allowed:
    torque is cut there; over, peak (2, worlds, 7): substeps of this period with a velocity beyond its margin, or a torque beyond its limit before the
    cut, and the largest shares of the limits. Reckoned in double precision: in single, 80 Nm come out up to 2e-5 Nm off.
    """
    i, j = wp.tid()
    new = 0
    if substep >= delay[i]:
        new = 3
    stiffness = wp.float64(command[new + 1, i, j])
    damping = wp.float64(command[new + 2, i, j]) * wp.sqrt(stiffness)
    error = wp.float64(command[new, i, j]) - wp.float64(qpos[i, j])
    coriolis = wp.float64(bias[i, j]) - wp.float64(gravity[i, j])
    wanted = stiffness * error - damping * wp.float64(qvel[i, j]) + coriolis + wp.float64(noise[i, j])
    torque = wp.float32(wanted)
    watch_share(substep, 0, i, j, wp.abs(qvel[i, j]) / limit[0, j], margin[i], over, peak)
    watch_share(substep, 1, i, j, wp.abs(torque) / limit[1, j], 1.0, over, peak)
    most = margin[i] * limit[1, j]
    ctrl[i, j] = wp.clamp(torque, -most, most)
