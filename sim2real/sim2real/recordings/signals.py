"""From raw, jittery logs to samples that can be compared: one uniform grid, one zero-phase filter for all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from np_description.phases import PhaseState
from sim2real.recordings.loop_timing import NOT_RECORDED, LoopTiming
from sim2real.thresholds import THRESHOLDS

RECORDINGS = THRESHOLDS.recordings

GRID = 0.002  # s
SMOOTHING = 0.012  # s, standard deviation of the Gaussian kernel: half power at 11 Hz
DECIMATION = 20  # samples come at 25 Hz: a kernel is about as wide as their distance, so noise stays white


@dataclass(frozen=True, eq=False)
class Commands:
    """m commands of the controller, k joints."""

    rows: np.ndarray
    """(m,), rows of the log from which they were computed."""
    target: np.ndarray
    """(m, k) rad."""
    target_velocity: np.ndarray
    """(m, k) rad/s."""
    torque: np.ndarray
    """(m, k) Nm without gravity."""
    torque_time: np.ndarray
    """(m,) s from which the torque is in force."""
    stiffness: np.ndarray
    """(m, k) Nm/rad that were set in the controller; zero before they were set."""
    damping: np.ndarray
    """(m, k) Nms/rad, likewise."""
    feedforward: bool = True
    """Whether the law adds the target's inertial torque."""
    has_law: bool = True
    """Whether law and gains are known, from the first gains on; of another arm's controller they may not be."""

    @property
    def has_gains(self) -> np.ndarray:
        """(m,) bool, whether the controller's gains had been set."""
        return (self.stiffness > 0).all(axis=1)


@dataclass(frozen=True, eq=False)
class Log:
    """One recording, n rows of k joints in the arm's order."""

    name: str
    """Name of the file or folder."""
    time: np.ndarray
    """(n,) s, increasing."""
    position: np.ndarray
    """(n, k) rad."""
    velocity: np.ndarray
    """(n, k) rad/s."""
    torque: np.ndarray
    """(n, k) Nm, measured."""
    torque_time: np.ndarray
    """(n,) s, moments of the torques."""
    with_gravity: bool
    """Whether torque includes that which holds the arm."""
    commands: Commands | None = None
    """What the controller commanded; None where not recorded."""
    motor: np.ndarray | None = None
    """(n, k) rad, angle before the gear on the joint's side of the ratio; None where the backend has none."""
    phases: tuple[tuple[float, PhaseState], ...] = ()
    """(s, phase), when each phase began."""
    is_current: bool = False
    """Whether `torque` is the motors' current in A as yet (`recordings.motor_current`)."""
    per_ampere: np.ndarray | None = None
    """(k,) Nm/A that made a torque of a current, where they had to be estimated; NaN where the recording does not determine it."""
    speed_lag: float = 0.0
    """s by which the reported speed was late, in whose place `velocity` is the derivative of position."""
    loop: LoopTiming = NOT_RECORDED
    """Timing of the control loop."""

    @property
    def duration(self) -> float:
        """s from the first to the last row."""
        return float(self.time[-1] - self.time[0])


@dataclass(frozen=True, eq=False)
class Samples:
    """Filtered samples of one or several trajectories."""

    time: np.ndarray
    """(n,) s within its trajectory."""
    trajectory: np.ndarray
    """(n,) number of the trajectory."""
    position: np.ndarray
    """(n, k) rad."""
    velocity: np.ndarray
    """(n, k) rad/s."""
    acceleration: np.ndarray
    """(n, k) rad/s^2."""
    torque: np.ndarray
    """(n, k) Nm."""
    torque_rate: np.ndarray
    """(n, k) Nm/s."""
    with_gravity: bool
    """As in `Log`."""
    noise: np.ndarray
    """(k,) Nm, standard deviation that white noise of the raw torque leaves in the filtered one."""
    shaking: np.ndarray
    """(k,) rad/s^2, standard deviation of the raw velocity's noise in the acceleration."""
    segments: tuple[tuple[np.ndarray, np.ndarray], ...]
    """(position, velocity) (m, k) on the fine grid, one for each stretch without a gap."""
    grids: tuple[tuple[int, np.ndarray], ...]
    """(trajectory, times (m,) s) of each stretch."""

    def __len__(self) -> int:
        return len(self.time)

    def filter_function(self, joint: int, function: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        """function(position (m,), velocity (m,)) -> (m,) of a joint on the fine grid, through the filter:
        (n,).

        What is not linear in the motion must be filtered like the torque, not computed from filtered motion.
        """
        parts = [function(position[:, joint], velocity[:, joint]) for position, velocity in self.segments]
        return self.filter(parts)

    def filter(self, parts: list[np.ndarray]) -> np.ndarray:
        """Values (m,) on the fine grid of each stretch, through the filter: (n,)."""
        return np.concatenate([_filter(part[:, None], _KERNEL)[:, 0] for part in parts])

    def projector(self, trajectory: np.ndarray, time: np.ndarray) -> csr_array:
        """What takes values (m,) of the moments `time` (m,) s of their `trajectory` (m,) to the samples (n,):
        interpolation and filter in one sparse matrix (n, m)."""
        starts, places, weights = [], [], []
        for number, grid in self.grids:
            mine = np.flatnonzero(trajectory == number)
            own = time[mine]
            below = np.clip(np.searchsorted(own, grid, side="right") - 1, 0, len(own) - 2)
            share = np.clip((grid - own[below]) / (own[below + 1] - own[below]), 0.0, 1.0)
            window = _windows(np.arange(len(grid)))
            places.append(np.stack([mine[below][window], mine[below + 1][window]], axis=2).reshape(len(window), -1))
            both = np.stack([1 - share, share], axis=1)[window]
            weights.append((both * _KERNEL[:, None]).reshape(len(window), -1))
            starts.append(np.full(len(window), places[-1].shape[1]))
        bounds = np.concatenate([[0], np.cumsum(np.concatenate(starts))])
        shape = (len(bounds) - 1, len(time))
        flat = [np.concatenate([part.ravel() for part in parts]) for parts in (weights, places)]
        return csr_array((flat[0], flat[1], bounds), shape=shape)

    def filter_extreme(self, joint: int, extreme) -> np.ndarray:
        """np.min or np.max (n,) of a joint's velocity over each sample's filter window."""
        parts = []
        for _, velocity in self.segments:
            column = velocity[:, joint]
            column = np.convolve(np.pad(column, 4, mode="edge"), np.full(9, 1 / 9), mode="valid")  # less noise
            parts.append(extreme(_windows(column), axis=1))
        return np.concatenate(parts)


def sample_logs(logs: list[Log], commanded: bool = False) -> Samples:
    """Samples of logs, whose torques must all include gravity or all exclude it. commanded: of the commanded torque, which has no sensor's
    noise, instead of the measured one.

    Every channel goes through the same filter, so that none is delayed against another. Raises ValueError
    for logs of both kinds, or where no stretch is long enough.
    """
    if len({log.with_gravity for log in logs}) != 1:
        raise ValueError("expected logs whose torques all include or all exclude gravity, got both")
    parts = [part for number, log in enumerate(logs) for part in _sample_log(log, number, commanded)]
    if not parts:
        raise ValueError(
            f"expected at least {RECORDINGS.shortest} s without a gap of {RECORDINGS.largest_gap} s, got none in "
            f"{', '.join(log.name for log in logs)}"
        )
    *columns, segments, grids = zip(*parts)
    columns = [np.concatenate(column) for column in columns]
    # Rows that lie closer than the grid are left out, not averaged: their noise stays.
    period = np.mean([max(np.median(np.diff(log.time)), GRID) for log in logs])
    torque, velocity = (
        np.sqrt(np.mean([white_noise(getattr(log, name)) ** 2 for log in logs], axis=0))
        for name in ("torque", "velocity")
    )
    noise = torque * np.sqrt(period / (2 * np.sqrt(np.pi) * SMOOTHING))
    shaking = velocity * np.sqrt(period / (4 * np.sqrt(np.pi) * SMOOTHING**3))
    return Samples(
        *columns, with_gravity=logs[0].with_gravity, noise=noise, shaking=shaking, segments=segments, grids=grids
    )


_UNHELD = 1 / 6
_HALF = round(4 * SMOOTHING / GRID)
_OFFSETS = np.arange(-_HALF, _HALF + 1) * GRID
_KERNEL = np.exp(-0.5 * (_OFFSETS / SMOOTHING) ** 2)
_KERNEL /= _KERNEL.sum()
# The exact derivative of a straight line under the sampled kernel, whatever its truncation.
_SLOPE = -_OFFSETS * _KERNEL / (_OFFSETS**2 * _KERNEL).sum()


def _sample_log(log: Log, number: int, commanded: bool):
    c = log.commands
    torque_time, torque_values = (c.torque_time, c.torque) if commanded else (log.torque_time, log.torque)
    edges = np.flatnonzero(np.diff(log.time) > RECORDINGS.largest_gap) + 1
    for rows in np.split(np.arange(len(log.time)), edges):
        if not rows.size or log.time[rows[-1]] - log.time[rows[0]] < RECORDINGS.shortest:
            continue
        grid = np.arange(log.time[rows[0]], log.time[rows[-1]], GRID)

        def at(time, values):
            return np.column_stack([np.interp(grid, time, column) for column in values.T])

        position, velocity = at(log.time[rows], log.position[rows]), at(log.time[rows], log.velocity[rows])
        torque = at(torque_time, torque_values)
        inner = slice(_HALF, len(grid) - _HALF, DECIMATION)
        kept = grid[inner] - log.time[0]
        yield (
            kept,
            np.full(kept.size, number),
            _filter(position, _KERNEL),
            _filter(velocity, _KERNEL),
            _filter(_smooth_held_commands(velocity, c.torque_time) if commanded else velocity, _SLOPE),
            _filter(torque, _KERNEL),
            _filter(torque, _SLOPE),
            (position, velocity),
            (number, grid),
        )


def _smooth_held_commands(velocity: np.ndarray, torque_time: np.ndarray) -> np.ndarray:
    """Velocity (m, k) on the fine grid, smoothed as commands are that are interpolated between middles of periods T.

    A command is held for its period, so that velocity runs in straight lines from stamp to stamp. At a frequency w
    its derivative is then (w T)^2 / 24 too large, the interpolated command (w T)^2 / 8 too small: a sixth of the
    second difference puts that right. It is .2 % of the inertia at 8 Hz, which would be called link_inertia.
    """
    smooth = velocity.copy()
    bend = _UNHELD * (float(np.median(np.diff(torque_time))) / GRID) ** 2
    smooth[1:-1] += bend * (velocity[2:] - 2 * velocity[1:-1] + velocity[:-2])
    return smooth


def white_noise(values: np.ndarray) -> np.ndarray:
    """Standard deviation (k,) of the white part of values (n, k), from third differences."""
    # They pass white noise (with the gain sqrt 20) and hardly any motion.
    return 1.4826 * np.median(np.abs(np.diff(values, 3, axis=0)), axis=0) / np.sqrt(20)


def _filter(values: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """values (m, c) through the kernel, at the samples (n, c): nothing is computed that decimation drops."""
    return np.column_stack([_windows(np.ascontiguousarray(column)) @ kernel[::-1] for column in values.T])


def _windows(column: np.ndarray) -> np.ndarray:
    """The values (n, width of the kernel) of a column (m,) in each sample's window."""
    return np.lib.stride_tricks.sliding_window_view(column, 2 * _HALF + 1)[::DECIMATION]
