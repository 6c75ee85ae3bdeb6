"""What a recording shows at each stage between target and motion, and where the nominal simulator differs.

r0: commanded torque minus the controller's law replayed; r1: measured minus commanded torque; both at the rate
of the recording. r2: torque minus inverse dynamics of the nominal arm, at 25 Hz through one filter; the torque is
the commanded one where there is one, so that the noise of the torque sensor is in r1 alone. r3: motor minus joint
angle. Residuals are what the arm shows beyond its nominal simulator.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from np_control.impedance import torque as impedance_torque
from np_control.safety import LIMITS, limit_torque
from sim2real.arm import rigid_body as rigid
from sim2real.arm.link_errors import link_error_torques
from sim2real.arm.model import Arm
from sim2real.arm.prediction import Prediction
from sim2real.effects.evidence import Drive
from sim2real.effects.recurrences import smooth_sign
from sim2real.effects.timing.command_delay import USUAL, delay_commands
from sim2real.recordings.signals import Log, Samples
from sim2real.thresholds import THRESHOLDS

RECORDINGS, ROWS = THRESHOLDS.recordings, THRESHOLDS.rows
ENDLESS = 1e6  # Nm


def is_sliding(samples: Samples, joint: int) -> np.ndarray:
    """Rows (n,) of the samples in whose whole filter window the joint slides in one direction."""
    slowest, fastest = (samples.filter_extreme(joint, extreme) for extreme in (np.min, np.max))
    return (slowest > ROWS.standstill) | (fastest < -ROWS.standstill)


def predict_torques(samples: Samples, arm: Arm) -> Prediction:
    """Nominal torques of the samples' motion."""
    q, dq, ddq = samples.position, samples.velocity, samples.acceleration
    gravity = rigid.gravity_torque(arm, q)
    inertial = rigid.inverse_dynamics(arm, q, dq, ddq) - gravity
    rotors = ddq * arm.armature
    direction = np.column_stack([samples.filter_function(j, lambda q, v: smooth_sign(v)) for j in range(len(arm))])
    friction = direction * arm.frictionloss + dq * arm.damping
    total = inertial + rotors + friction + (gravity if samples.with_gravity else 0.0)
    motion = rigid.forward_recursion(arm, q, dq, ddq)
    return Prediction(
        gravity,
        inertial,
        rotors,
        friction,
        total,
        gravity + inertial,
        direction,
        motion,
        rigid.gravity_slope(arm, q),
        rigid.link_inertia_torque(arm, motion),
        link_error_torques(arm, samples),
    )


def predict_expected_torque(position, velocity, acceleration, arm: Arm, with_gravity: bool) -> np.ndarray:
    """What the sensors of the nominal arm would show (n, k) Nm of a motion; near standstill only roughly."""
    still = None if with_gravity else np.zeros(3)
    rigid_part = rigid.inverse_dynamics(arm, position, velocity, acceleration, still)
    return rigid_part + acceleration * arm.armature + smooth_sign(velocity) * arm.frictionloss + velocity * arm.damping


def make_drive(logs: list[Log], arm: Arm, reference: int = 0) -> Drive | None:
    """The drive side of logs with commands, None where none has. reference: how many of them, the first, are of the arm as it
    was, whose loop's delay then counts; 0: all."""
    parts, starts, count = [], [], 0
    period = 0.0
    for number, log in enumerate(logs):
        c = log.commands
        if c is None or len(c.rows) < 3:
            continue
        period = float(np.median(np.diff(log.time)))
        follows = c.rows + 1 < len(log.time)
        if c.has_law:
            follows &= c.has_gains
        rows = c.rows[follows]
        selected = np.flatnonzero(follows)[
            np.abs(log.time[rows + 1] - log.time[rows] - period) < RECORDINGS.answer * period
        ]
        rows = c.rows[selected]
        law, error = (
            _replay_law(log, arm, selected) if c.has_law else (c.torque[selected], np.zeros_like(c.torque[selected]))
        )
        guarded = _find_clipped(log, arm, selected, period)
        begins = np.flatnonzero(np.diff(log.time[rows], prepend=-1.0) > RECORDINGS.command_gap * period)
        starts.append(count + np.union1d(begins, [0]))
        count += len(rows)
        still = rigid.gravity_torque(arm, log.position[rows])
        parts.append(
            (
                log.time[rows],
                np.full(len(rows), number),
                law,
                c.torque[selected],
                log.torque[rows + 1],
                error,
                log.velocity[rows],
                c.target_velocity[selected],
                c.stiffness[selected],
                c.damping[selected],
                still,
                guarded,
            )
        )
    if not parts:
        return None
    time, trajectory, *rest = (np.concatenate(column) for column in zip(*parts))
    is_replayed = all(log.commands.has_law for log in logs if log.commands is not None)
    found = Drive(time, trajectory, period, np.concatenate(starts), *rest, 0.0, rest[1], is_replayed)
    before = trajectory < reference
    late = _estimate_delay(found, before if before.any() else np.ones(len(time), bool))
    arrived = np.column_stack([delay_commands(found, column, late) for column in found.commanded.T])
    return replace(found, late=late, arrived=arrived)


def _estimate_delay(d: Drive, rows: np.ndarray) -> float:
    """What the loop is late by, s, up to what any is: by how much of its last step the measured torque lags behind each
    command, the median over the joints. Looked at are rows (n,) bool; periods that show nothing but the command before (a lost
    packet) are left out."""
    step = np.diff(d.commanded, axis=0, prepend=d.commanded[:1])
    step[d.starts] = 0.0
    step, residual = step[rows], (d.measured - d.commanded)[rows]
    selected, share = np.ones(len(step), bool), 0.0
    for _ in range(2):
        moved = np.maximum(np.square(step[selected]).sum(axis=0), 1e-12)
        share = float(np.median(-(residual * step)[selected].sum(axis=0) / moved))
        share = min(max(share, 0.0), USUAL / d.period)
        spread = np.maximum(np.median(np.abs(residual + share * step), axis=0), 1e-6)
        on_time, lost = (np.square((residual + s * step) / spread).sum(axis=1) for s in (share, 1.0))
        selected = on_time <= lost
    return share * d.period


def _find_clipped(log: Log, arm: Arm, selected: np.ndarray, period: float) -> np.ndarray:
    """Commands (m, k) bool that lie where the controller's own guards allow no more: they do not contain the law's own output.

    Judged by the recorded command, not by the law replayed, which may have other gains than the controller. Guards of
    another arm are not known: none of its commands counts as guarded.
    """
    if arm.joints != LIMITS.joints:
        return np.zeros((len(selected), len(arm)), bool)
    c, limits = log.commands, replace(LIMITS, period_ns=round(1e9 * period))
    before = c.torque[np.maximum(selected - 1, 0)]
    state = log.position[c.rows[selected]], log.velocity[c.rows[selected]]
    lowest, highest = (
        limit_torque(limits, np.full_like(before, side), before, *state)[0] for side in (-ENDLESS, ENDLESS)
    )
    return (c.torque[selected] <= lowest + ROWS.guard) | (c.torque[selected] >= highest - ROWS.guard)


def _replay_law(log: Log, arm: Arm, selected: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(torque (m, k) Nm of the controller's law, its position error (m, k) rad) for these commands."""
    c = log.commands
    rows = c.rows[selected]
    q, dq = log.position[rows], log.velocity[rows]
    rate = np.gradient(c.target_velocity, log.time[c.rows], axis=0)[selected]
    if not c.feedforward:
        rate = np.zeros_like(rate)
    feed = rigid.feedforward_torque(arm, q, dq, rate)
    kp, kd = c.stiffness[selected], c.damping[selected]
    lead = c.target[selected] + kd / kp * c.target_velocity[selected]
    return impedance_torque(q, dq, lead, kp, kd / np.sqrt(kp), feed), lead - q
