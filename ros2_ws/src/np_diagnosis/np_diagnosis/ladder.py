"""The residual ladder: at which rung between command and motion the nominal simulator departs from the arm.

r0 replayed controller minus commanded torque; r1 measured minus commanded torque; r2 measured torque minus
inverse dynamics of the nominal arm. Each joint, each regime of motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_control.controller import ControllerConfig
from np_control.dynamics import Dynamics
from np_control.impedance import damping, torque as impedance_torque

from np_diagnosis.nominal import STANDSTILL
from np_diagnosis.signals import Log, Samples

REGIMES = ("standstill", "reversal", "slow", "fast", "accelerating")
REVERSAL = 0.1  # s on either side of a change of direction
FAST = 0.3  # rad/s
ACCELERATING = 2.0  # rad/s^2
STRIDE = 5  # commands are replayed at 100 Hz


@dataclass(frozen=True, eq=False)
class Rung:
    """RMS of one residual: by joint (7,) Nm."""

    name: str
    meaning: str
    rms: np.ndarray


def regimes(samples: Samples) -> dict[str, np.ndarray]:
    """Masks (n, 7): each sample of a joint is in exactly one regime."""
    velocity, acceleration = samples.velocity, samples.acceleration
    standing = np.abs(velocity) <= STANDSTILL
    reversing = np.zeros_like(standing)
    for j in range(velocity.shape[1]):
        turns = np.flatnonzero(np.diff(np.sign(velocity[:, j])) != 0)
        if turns.size:
            nearest = np.abs(samples.time[:, None] - samples.time[turns]).min(axis=1)
            reversing[:, j] = nearest < REVERSAL
    masks, rest = {}, np.ones_like(standing)
    for name, mask in (
        ("standstill", standing),
        ("reversal", reversing),
        ("accelerating", np.abs(acceleration) > ACCELERATING),
        ("fast", np.abs(velocity) > FAST),
    ):
        masks[name], rest = rest & mask, rest & ~mask
    return {name: masks.get(name, rest) for name in REGIMES}


def rungs(log: Log) -> list[Rung]:
    """r0 and r1 of a log with commands; none of a log without."""
    commands = log.commands
    if commands is None:
        return []
    ladder = []
    if commands.has_own_gains:
        ladder.append(Rung("r0", "replayed controller minus commanded torque", _rms(_replayed(log))))
    inside = (log.torque_time >= commands.torque_time[0]) & (log.torque_time <= commands.torque_time[-1])
    commanded = np.column_stack(
        [np.interp(log.torque_time[inside], commands.torque_time, column) for column in commands.torque.T]
    )
    ladder.append(Rung("r1", "measured minus commanded torque", _rms(log.torque[inside] - commanded)))
    return ladder


def _replayed(log: Log) -> np.ndarray:
    """What the controller's law with its own gains says, minus what it commanded (m, 7) Nm."""
    commands, config, dynamics = log.commands, ControllerConfig(), Dynamics()
    ratio = np.full(len(config.stiffness), config.damping_ratio)
    lead = damping(config.stiffness, ratio) / config.stiffness
    rate = np.gradient(commands.target_velocity, log.time[commands.rows], axis=0)
    # Where the target's acceleration jumps, its derivative between two rows is not what was fed forward.
    smooth = np.abs(np.gradient(rate, axis=0)).max(axis=1) < 0.5
    smooth[[0, -1]] = False
    kept = np.flatnonzero(smooth)[::STRIDE]
    residual = np.empty((kept.size, len(config.stiffness)))
    for n, i in enumerate(kept):
        row = commands.rows[i]
        q, dq = log.position[row], log.velocity[row]
        feedforward = dynamics.coriolis(q, dq) + dynamics.mass_matrix(q) @ rate[i]
        target = commands.target[i] + lead * commands.target_velocity[i]
        residual[n] = (
            impedance_torque(q, dq, target, config.stiffness, ratio, feedforward) - commands.torque[i]
        )
    return residual


def _rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt((values**2).mean(axis=0)) if len(values) else np.full(values.shape[1], np.nan)
