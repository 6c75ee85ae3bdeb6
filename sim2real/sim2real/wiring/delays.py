"""Whether signals of the joints are a sample early or late.

The controller's law is exact: with the right state it leaves nothing of its command, with the one before it leaves what the measured speed's
noise and a period's motion make of it. An effort is compared by its steps with those of the command, and by its phase with the motion.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import nnls

from sim2real.arm.model import Arm
from sim2real.arm.rigid_body import feedforward_torque, inverse_dynamics
from sim2real.recordings.signals import Log
from sim2real.thresholds import THRESHOLDS
from sim2real.wiring.fault import WiringFault
from sim2real.wiring.joint_relations import feedback_torque

WIRING = THRESHOLDS.wiring
ROWS, PHASES = 4000, 2000  # of a recording that are compared
SMOOTH = 0.04  # s, of two running means one after the other
SLIDE, MOVES = 0.02, 0.05  # rad/s, of the smooth step of friction; from which on a joint does not reverse


def find_delay_fault(log: Log, arm: Arm) -> WiringFault | None:
    """Of a log with commands of a known law; None without."""
    c = log.commands
    if c is None or len(c.rows) < 100:
        return None
    if c.has_law:
        errors = dict(_law_errors(log, arm))
        best = min(errors, key=errors.get)
        if errors[best] * WIRING.sharply < errors["", 0]:
            return _fault(*best)
    return _effort_fault(log, arm)


def _law_errors(log: Log, arm: Arm) -> Iterator[tuple[tuple[str, int], float]]:
    """By stream and samples that it is late: median error of the law, as a share of the torque limits, mean over joints."""
    c, count = log.commands, len(log.commands.rows)
    rows = np.arange(2, count - 2, -(-count // ROWS))
    position, velocity = log.position[c.rows], log.velocity[c.rows]
    acceleration = np.gradient(c.target_velocity, log.time[c.rows], axis=0)[rows]
    fed = feedforward_torque(arm, position[rows], velocity[rows], acceleration)

    def error(late_position: int, late_velocity: int, late_command: int) -> float:
        state = position[rows + late_position], velocity[rows + late_velocity]
        force = (
            feedback_torque(*state, c.target[rows], c.target_velocity[rows], c.stiffness[rows], c.damping[rows]) + fed
        )
        return float(np.mean(np.median(np.abs(force - c.torque[rows + late_command]), axis=0) / arm.torque_limit))

    yield ("", 0), error(0, 0, 0)
    for late in (-1, 1):
        yield ("position of joint_states", late), error(late, 0, 0)
        yield ("velocity of joint_states", late), error(0, late, 0)
        yield ("joint_states", late), error(late, late, 0)
        yield ("effort of effort_command", late), error(0, 0, late)


def _effort_fault(log: Log, arm: Arm) -> WiringFault | None:
    """An effort that follows the command and the motion a sample too late or too early. A command that only takes effect later is no fault."""
    steps = {late: _step_agreement(log, late) for late in (-1, 0, 1)}
    late = max(steps, key=steps.get)
    if not late or steps[late] < steps[0] + WIRING.step_agreement:
        return None
    period = float(np.median(np.diff(log.time)))
    return _fault("effort of joint_states", late) if abs(effort_phase(log, arm) / period - late) < 0.5 else None


def _step_agreement(log: Log, late: int) -> float:
    """Correlation, median of joints, of steps of the effort with those of the command, if the effort is late by some samples."""
    c = log.commands
    answers = np.flatnonzero((c.rows > 3) & (c.rows < len(log.torque) - 3) & (np.arange(len(c.rows)) > 0))
    after = c.rows[answers] + 1 + late  # an effort is that of the period that ends at its stamp
    measured, commanded = log.torque[after] - log.torque[after - 1], c.torque[answers] - c.torque[answers - 1]
    size = np.sqrt((measured**2).sum(axis=0) * (commanded**2).sum(axis=0))
    return float(np.median((measured * commanded).sum(axis=0) / np.maximum(size, 1e-12)))


def effort_phase(log: Log, arm: Arm) -> float:
    """s by which the measured effort is later than the motion: least squares of what the rigid body, friction and rotor leave, with the slope
    of what they explain, where joints do not reverse."""
    period, count = float(np.median(np.diff(log.time))), len(log.time)
    half = max(1, round(SMOOTH / period / 2))

    def smooth(values: np.ndarray) -> np.ndarray:
        return uniform_filter1d(uniform_filter1d(values, 2 * half + 1, axis=0), 2 * half + 1, axis=0)

    position, velocity, effort = smooth(log.position), smooth(log.velocity), smooth(log.torque)
    acceleration = np.gradient(velocity, period, axis=0)
    rows = np.arange(6 * half, count - 6 * half, -(-count // PHASES))
    gravity = None if log.with_gravity else np.zeros(3)

    def model(at: np.ndarray) -> np.ndarray:
        rigid = inverse_dynamics(arm, position[at], velocity[at], acceleration[at], gravity)
        return np.stack([rigid, np.tanh(velocity[at] / SLIDE), velocity[at], acceleration[at]], axis=-1)

    columns, slopes = model(rows), (model(rows + half) - model(rows - half)) / (2 * half * period)
    top = bottom = 0.0
    for j in range(len(arm)):
        own, shown = columns[:, j] - columns[:, j].mean(axis=0), effort[rows, j] - effort[rows, j].mean()
        factors, _ = nnls(own, shown)
        moves = np.abs(velocity[rows, j]) > MOVES
        left, slope = (shown - own @ factors)[moves], (slopes[:, j] @ factors)[moves]
        if moves.any():
            weight = 1.0 / max(float(left.var()), 1e-9)
            top += weight * float(left @ slope)
            bottom += weight * float(slope @ slope)
    return -top / max(bottom, 1e-12) - period / 2


def _fault(stream: str, late: int) -> WiringFault:
    topic = stream.rpartition(" of ")[2]
    other = "effort_command" if stream == "joint_states" else f"the rest of {topic}"
    word, sign = ("late", "earlier") if late > 0 else ("early", "later")
    return WiringFault(
        "delay",
        topic,
        f"The {stream} is one sample too {word} for {other}.",
        f"Publish the {stream} of the sample {sign}, under the stamp of its acquisition.",
    )
