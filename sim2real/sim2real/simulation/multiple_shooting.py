"""r4: the closed loop in the simulator, from recorded targets and gains, against the recorded motion.

The torque domain shows what the model lacks; this shows the effect on the arm's motion. The simulator is started
from recorded states again and again (multiple shooting), each time for a short while, under the impedance law with
the recorded targets: nominal, or with a patch. What was fed forward is taken from the recording. All windows and
patches are stepped side by side (mujoco.batch).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from np_description.panda import JOINT_NAMES
from sim2real.effects.arm_effects import ArmEffects
from sim2real.effects.patch import Patch
from sim2real.recordings.signals import Log
from sim2real.simulation.simulated_arm import compile_arm, panda_spec
from sim2real.thresholds import THRESHOLDS

SHOT = THRESHOLDS.simulation

_BAD = [
    int(w)
    for w in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
]


@dataclass(frozen=True, eq=False)
class ShootingWindows:
    """W stretches of recordings of m rows each, one row a control period."""

    period: float
    """s, control period."""
    warm: int
    """Number of rows before the simulation starts."""
    start: np.ndarray
    """(W,) s since the recording began."""
    position: np.ndarray
    """(W, m, 7) rad."""
    velocity: np.ndarray
    """(W, m, 7) rad/s."""
    lead: np.ndarray
    """(W, m, 7) rad, target with its lead."""
    stiffness: np.ndarray
    """(W, m, 7) Nm/rad."""
    damping: np.ndarray
    """(W, m, 7) Nms/rad."""
    fed: np.ndarray
    """(W, m, 7) Nm, feedforward torque."""
    commanded: np.ndarray
    """(W, m, 7) Nm."""

    def __len__(self) -> int:
        return len(self.start)

    def __getitem__(self, which: slice | np.ndarray) -> ShootingWindows:
        names = ("start", "position", "velocity", "lead", "stiffness", "damping", "fed", "commanded")
        return ShootingWindows(self.period, self.warm, *(getattr(self, name)[which] for name in names))

    @property
    def sampled(self) -> np.ndarray:
        """Rows that are compared."""
        first = self.warm + round(SHOT.settled / self.period)
        return np.arange(first, self.position.shape[1], max(1, round(SHOT.sample / self.period)))


def cut_windows(
    logs: Sequence[Log], every: float = SHOT.every, spans: Sequence[tuple[int, float, float]] = ()
) -> ShootingWindows | None:
    """Windows of all recordings of the Panda with commands at one rate; None where there are none.

    spans: (number of the log, begin s, end s) in which they lie side by side; none: anywhere, `every` s apart.
    """
    parts, period = [], None
    for number, log in enumerate(logs):
        c = log.commands
        if c is None or not c.has_law or log.position.shape[1] != len(JOINT_NAMES):
            continue
        log_period = float(np.median(np.diff(log.time)))
        if period is not None and abs(log_period - period) > SHOT.period_tolerance * period:
            continue
        period = log_period
        stiffness = np.where(c.has_gains[:, None], c.stiffness, np.nan)
        lead = c.target + c.damping / stiffness * c.target_velocity
        q, dq = log.position[c.rows], log.velocity[c.rows]
        fed = c.torque - c.stiffness * (lead - q) + c.damping * dq
        rows = round((SHOT.warm + SHOT.window) / period) + 1
        time = log.time[c.rows]
        step = rows if spans else max(1, round(every / period))
        where = [(a, b) for n, a, b in spans if n == number] if spans else [(-np.inf, np.inf)]
        firsts = [k for a, b in where for k in _firsts(time, a, b, rows, step)]
        for first in firsts:
            s = slice(first, first + rows)
            if c.rows[first + rows] - c.rows[first] == rows and c.has_gains[s].all():
                parts.append(
                    (
                        log.time[c.rows[first]],
                        q[s],
                        dq[s],
                        lead[s],
                        c.stiffness[s],
                        c.damping[s],
                        fed[s],
                        c.torque[s],
                    )
                )
    if not parts:
        return None
    return ShootingWindows(period, round(SHOT.warm / period), *(np.array(column) for column in zip(*parts)))


def _firsts(time: np.ndarray, begin: float, end: float, rows: int, step: int) -> range:
    """First rows, `step` apart, of windows of `rows` rows that lie between begin and end s of commands at times (m,) s."""
    first, last = np.searchsorted(time, [begin, end])
    return range(max(int(first), SHOT.smooth), min(int(last), len(time) - SHOT.smooth) - rows, step)


def simulate_departures(recorded: ShootingWindows, patches: Sequence[Patch]) -> np.ndarray:
    """Simulated minus recorded joint angles (P, W, samples, 7) rad of each patch in each window.

    Raises FloatingPointError where a simulation diverges.
    """
    count, number = len(recorded), len(patches)
    models = [compile_arm(panda_spec(patch.panda(), recorded.period)) for patch in patches]
    batch = Batch(models[0], count * number, int(os.environ.get("OMP_NUM_THREADS", "0")))
    batch.set_models([model for model in models for _ in range(count)])
    w = {
        name: np.tile(getattr(recorded, name), (number, 1, 1))
        for name in ("position", "velocity", "lead", "stiffness", "damping", "fed", "commanded")
    }
    spread = [patch for patch in patches for _ in range(count)]
    effects = ArmEffects(spread, recorded.period, begin=np.tile(recorded.start, number))
    bias = np.array([patch.per_joint("encoder_bias", "bias") for patch in spread])
    late = np.array([patch.per_joint("measurement_delay", "delay") for patch in spread])
    late = np.maximum(late, 0.0) / recorded.period
    true, speed = _true_states(w["position"] - bias[:, None], w["velocity"], late)
    for k in range(recorded.warm):
        effects.sense(true[:, k], speed[:, k], w["commanded"][:, k])
        effects.drive(w["commanded"][:, k], true[:, k])
        effects.extra(true[:, k], speed[:, k])
    batch.qpos[:], batch.qvel[:] = true[:, recorded.warm], speed[:, recorded.warm]
    compared, found = set(recorded.sampled.tolist()), []
    for k in range(recorded.warm, true.shape[1]):
        q, dq = batch.qpos, batch.qvel
        measured, seen_speed, _ = effects.sense(q, dq, np.zeros_like(q))
        if k in compared:
            found.append(measured - w["position"][:, k])
        torque = w["stiffness"][:, k] * (w["lead"][:, k] - measured) - w["damping"][:, k] * seen_speed + w["fed"][:, k]
        batch.ctrl[:] = effects.drive(torque, q)
        batch.qfrc_applied[:] = effects.extra(q, dq)
        batch.step()
    errors = np.array(found).swapaxes(0, 1)
    diverged = batch.warning[:, _BAD, 1].any(axis=1) | ~np.isfinite(errors).all(axis=(1, 2))
    if diverged.any():
        at = recorded.start[int(np.flatnonzero(diverged)[0]) % count]
        raise FloatingPointError(f"the simulation from {at:.2f} s diverged")
    return errors.reshape(number, count, *errors.shape[1:])


def rms(errors: np.ndarray) -> np.ndarray:
    """RMS (..., 7) rad over windows and samples of departures (..., W, samples, 7)."""
    return np.sqrt(np.square(errors).mean(axis=(-3, -2)))


def _true_states(position: np.ndarray, velocity: np.ndarray, late: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles and speeds (S, m, 7) as they were, of recorded ones that are `late` (S, 7) periods old.

    The last ones are held. Speeds are averaged, for the noise of an encoder at the start is no motion.
    """
    kernel = np.ones(SHOT.smooth) / SHOT.smooth
    padded = np.pad(velocity, ((0, 0), (SHOT.smooth // 2, SHOT.smooth // 2), (0, 0)), mode="edge")
    smooth = np.stack([padded[:, k : k + velocity.shape[1]] for k in range(SHOT.smooth)]).transpose(1, 2, 3, 0) @ kernel
    rows = np.arange(position.shape[1])[None, :, None] + late[:, None]
    below = np.minimum(np.floor(rows).astype(int), position.shape[1] - 1)
    above = np.minimum(below + 1, position.shape[1] - 1)
    share = rows - np.floor(rows)
    return tuple(
        (1 - share) * np.take_along_axis(v, below, 1) + share * np.take_along_axis(v, above, 1)
        for v in (position, smooth)
    )
