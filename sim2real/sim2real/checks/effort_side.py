"""Which torque a recording's `effort` is: that of the drive, or that of a sensor after the gear (docs/reference/graph.md).

A drive's torque includes the friction and the rotor of its joint; a sensor after the gear measures what moves the link. No
fault of an arm removes the rotors of most joints. Part of a joint's friction may lie after the sensor, in bearings and cables, so
that the rotor alone decides where there is friction. In a sinusoid, a torque that depends on the position alone resembles a
rotor's: wrong compensation of gravity, a cable, a steady pull. Such torques are estimated beside the rotor's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim2real.arm import rigid_body as rigid
from sim2real.arm.model import Arm
from sim2real.effects.recurrences import smooth_sign
from sim2real.recordings.signals import Log, sample_logs
from sim2real.thresholds import THRESHOLDS

EFFORT = THRESHOLDS.effort
DRIVE, SENSOR = "drive", "sensor"


def is_after_gear(logs: Sequence[Log], arm: Arm, commanded: bool = False) -> bool:
    """Whether the measured torque (commanded: the commanded one) lacks the joints' nominal friction or their rotors.

    Least squares gives the share of either that the torque has, joint by joint; the medians over the joints that slide decide.
    """
    samples, shares = sample_logs(list(logs), commanded), []
    gravity = None if samples.with_gravity else np.zeros(3)
    rigid_part = rigid.inverse_dynamics(arm, samples.position, samples.velocity, samples.acceleration, gravity)
    # Torques by 1 m/s^2 along each axis: a linear model of wrong gravity in any direction.
    gravities = np.stack([rigid.gravity_torque(arm, samples.position, axis) for axis in np.eye(3)], axis=-1)
    for j in range(len(arm)):
        friction = (
            samples.filter_function(j, lambda q, v: smooth_sign(v)) * arm.frictionloss[j]
            + samples.velocity[:, j] * arm.damping[j]
        )
        slides = np.abs(samples.velocity[:, j]) > THRESHOLDS.rows.standstill
        if slides.sum() < EFFORT.rows or not friction[slides].any():
            continue
        rotor = samples.acceleration[slides, j] * (arm.armature[j] or 1.0)
        # An offset, a wrong scale of the link's torque, and torques by position are neither.
        others = np.column_stack([np.ones(len(samples)), rigid_part[:, j], samples.position[:, j], gravities[:, j]])[
            slides
        ]
        columns = np.column_stack([friction[slides], others, rotor])
        residual = samples.torque[slides, j] - rigid_part[slides, j]
        has_friction, *_, has_rotor = np.linalg.lstsq(columns, residual, rcond=None)[0]
        apart = rotor - columns[:, :-1] @ np.linalg.lstsq(columns[:, :-1], rotor, rcond=None)[0]
        is_determined = arm.armature[j] > 0 and np.std(apart) > EFFORT.apart * np.std(rotor)
        shares.append((has_friction, has_rotor if is_determined else np.nan))
    if not shares:
        return False
    friction, rotor = np.transpose(shares)
    lacks_rotors = np.isfinite(rotor).any() and np.nanmedian(rotor) < EFFORT.share
    return bool(np.median(friction) < EFFORT.share or lacks_rotors)


def convert_to_drive_side(logs: Sequence[Log], arm: Arm, side: str | None) -> tuple[list[Log], Arm]:
    """(logs, arm) that go with each other: what the drives give, and the arm that they move.

    side: DRIVE, SENSOR, or None to infer it from the recording. Where commands are what a sensor after the gear shows as well (a drive
    that closes its loop about that sensor), nothing of joint friction is left in either, and the arm is the rigid body. Where
    the commands are the drives', the measured torque gets the nominal friction and rotor of its joints back.
    """
    logs = list(logs)
    after_gear = is_after_gear(logs, arm) if side is None else side == SENSOR
    if not after_gear or not (arm.frictionloss.any() or arm.damping.any()):
        return logs, arm
    if any(log.commands is None for log in logs) or is_after_gear(logs, arm, commanded=True):
        return logs, arm.rigid_body_only()
    return [_with_friction(log, arm) for log in logs], arm


def _with_friction(log: Log, arm: Arm) -> Log:
    speed = np.column_stack([np.interp(log.torque_time, log.time, v) for v in log.velocity.T])
    padded = np.pad(speed, ((EFFORT.smooth // 2, EFFORT.smooth // 2), (0, 0)), mode="edge")
    smooth = np.lib.stride_tricks.sliding_window_view(padded, EFFORT.smooth, axis=0).mean(axis=-1)
    rotors = np.gradient(smooth, log.torque_time, axis=0) * arm.armature
    return replace(log, torque=log.torque + smooth_sign(smooth) * arm.frictionloss + speed * arm.damping + rotors)
