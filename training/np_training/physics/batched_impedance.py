"""The joint impedance law and the guards on its torque in every world: np_control as a kernel of Warp."""

from __future__ import annotations

import warp as wp

from np_control.safety import SafetyLimits
from np_description.panda import NOMINAL


@wp.struct
class Guards:
    """What `np_control.safety.limits.limit_torque` needs of `SafetyLimits`; arrays (7,)."""

    velocity: wp.array(dtype=wp.float64)
    """Limit, rad/s."""
    torque: wp.array(dtype=wp.float64)
    """Limit, Nm."""
    wall_lower: wp.array(dtype=wp.float64)
    """Lower soft wall, rad."""
    wall_upper: wp.array(dtype=wp.float64)
    """Upper soft wall, rad."""
    cruise: wp.array(dtype=wp.float64)
    """Greatest speed that the guards allow, rad/s."""
    slope: wp.array(dtype=wp.float64)
    """Torque for each rad/s left to a bound that is near, Nms/rad."""
    retraction: wp.array(dtype=wp.float64)
    """Square of the torque for each rad/s left to a bound that is far, Nm^2 s/rad."""
    wall_rate: wp.float64
    """Speed towards a wall for each rad left, 1/s."""
    step: wp.float64
    """Largest change of torque from one physics step to the next, Nm."""


def make_guards(limits: SafetyLimits, device: str) -> Guards:
    """The guards of `limits`, whose period is that of the physics steps."""
    guards = Guards()
    for name, values in (
        ("velocity", limits.velocity),
        ("torque", limits.torque),
        ("wall_lower", limits.wall_lower),
        ("wall_upper", limits.wall_upper),
        ("cruise", limits.cruise),
        ("slope", limits.speed_slope),
        ("retraction", limits.retraction),
    ):
        setattr(guards, name, wp.array(values, dtype=wp.float64, device=device))
    guards.wall_rate, guards.step = limits.wall_rate, limits.torque_step
    return guards


def nominal_guards(timestep: float, device: str) -> Guards:
    """The guards of the nominal arm at physics steps of `timestep` s."""
    return make_guards(SafetyLimits.of(NOMINAL, period_ns=round(timestep * 1e9)), device)


@wp.func
def torque_towards(guards: Guards, j: int, room: wp.float64):
    """Greatest torque Nm of joint j towards a velocity bound that is `room` rad/s away."""
    far = wp.sqrt(guards.retraction[j] * wp.max(room, wp.float64(0.0)))
    most = guards.torque[j]
    return wp.clamp(wp.min(guards.slope[j] * room, far), -most, most)


@wp.func
def guard_torque(guards: Guards, j: int, torque: wp.float64, previous: float, position: float, velocity: float):
    """`limit_torque` of a torque Nm within the limits: walls and speed, then the rate."""
    q = wp.float64(position)
    dq = wp.float64(velocity)
    cruise = guards.cruise[j]
    least_speed = wp.clamp(guards.wall_rate * (guards.wall_lower[j] - q), -cruise, cruise)
    most_speed = wp.clamp(guards.wall_rate * (guards.wall_upper[j] - q), -cruise, cruise)
    lower = -torque_towards(guards, j, dq - least_speed)
    upper = torque_towards(guards, j, most_speed - dq)
    if upper < wp.float64(0.0):
        lower = wp.min(lower, upper)
    upper = wp.max(lower, upper)
    guarded = wp.clamp(torque, lower, upper)
    before = wp.float64(previous)
    return wp.clamp(guarded, before - guards.step, before + guards.step)


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
    guards: Guards,
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    bias: wp.array2d(dtype=float),
    gravity: wp.array2d(dtype=float),
    command: wp.array3d(dtype=float),
    delay: wp.array(dtype=int),
    noise: wp.array2d(dtype=float),
    margin: wp.array(dtype=float),
    applied: wp.array2d(dtype=float),
    ctrl: wp.array2d(dtype=float),
    over: wp.array3d(dtype=int),
    peak: wp.array3d(dtype=float),
):
    """np_control.impedance.torque for joint j of world i, guarded by `limit_torque`; a test holds both to the same result.

    command (6, worlds, 7): joint target, stiffness, damping ratio of the last period, then of this one, which
    takes effect after `delay` substeps. margin (worlds,): share of the limits that is allowed: torque is cut there; applied (worlds, 7): torque
    of the last substep, then of this one; over, peak (2, worlds, 7): substeps of this period with a velocity beyond its margin, or a torque beyond its limit before the
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
    watch_share(substep, 0, i, j, wp.abs(qvel[i, j]) / wp.float32(guards.velocity[j]), margin[i], over, peak)
    watch_share(substep, 1, i, j, wp.abs(torque) / wp.float32(guards.torque[j]), 1.0, over, peak)
    most = wp.float64(margin[i]) * guards.torque[j]
    lawful = wp.clamp(wanted, -most, most)
    applied[i, j] = wp.float32(guard_torque(guards, j, lawful, applied[i, j], qpos[i, j], qvel[i, j]))
    ctrl[i, j] = applied[i, j]
