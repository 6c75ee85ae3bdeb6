"""The hooks by which an effect acts in a simulated arm, once a control period, on one arm or on S side by side."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from np_common.rotations import namespace
from sim2real.effects.arrays import NUMPY, Arrays

STICTION_SPEED = 0.005  # rad/s at which a friction that is an explicit torque has its full level

DriveFunction = Callable[[np.ndarray], np.ndarray]
"""Torque (..., 7) Nm to torque (..., 7) Nm, called once a period."""
ResistanceFunction = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Angles, speeds (..., 7) to the torque (..., 7) Nm that resists, called once a period."""


@dataclass(frozen=True)
class HookContext:
    """An effect's quantities in the patches of all arms."""

    of: Callable[[str], np.ndarray]
    """Name of a quantity -> its values (*lead, 7) as a NumPy array."""
    lead: tuple[int, ...]
    """() for one arm, (S,) for S arms."""
    period: float
    """s, control period."""
    seed: int
    """Seed of what is random."""
    begin: np.ndarray
    """(*lead) s for which the arms had been moving."""
    arrays: Arrays = NUMPY
    """The library of the hooks' arrays."""

    def __call__(self, name: str) -> np.ndarray:
        """A quantity (*lead, 7) by joint, 0 where the effect is not."""
        return self.arrays.array(self.of(name))


class DriveSlot(IntEnum):
    """The order in which a drive treats a command."""

    ARRIVAL = 0
    TRANSPORT = 1
    RATE = 2
    LIMIT = 3
    LAG = 4
    GAIN = 5
    OFFSET = 6


class SensorSlot(IntEnum):
    """The order in which a measurement goes wrong."""

    AGE = 0
    ZERO = 1
    STEP = 2
    TORQUE = 3


@dataclass(frozen=True)
class DriveHook:
    """What a drive makes of the commanded torque."""

    slot: DriveSlot
    """When it acts."""
    make: Callable[[HookContext], DriveFunction]
    """Makes the function of one simulation."""
    of_total: bool = False
    """Whether it acts on all torque of the drive, compensated gravity included, except in joints with the quantity `gravity_apart`."""


@dataclass(frozen=True)
class SensorHook:
    """What sensors make of angle, speed and torque (..., 7) each."""

    slot: SensorSlot
    """When it acts."""
    make: Callable[
        [HookContext], Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
    ]
    """Makes the function of one simulation."""


class DelayLine:
    """A delay by a number of periods (..., 7), fractions interpolated; before the beginning, the first value."""

    def __init__(self, periods: np.ndarray):
        self._periods = periods
        self._past: deque[np.ndarray] = deque(maxlen=int(periods.max()) + 2)

    def __call__(self, value: np.ndarray) -> np.ndarray:
        """What is there after the delay while `value` comes in."""
        self._past.append(value)
        return _interpolate_past(self._past, namespace(value).broadcast_to(self._periods, value.shape))


def _interpolate_past(past: Sequence[np.ndarray], periods: np.ndarray) -> np.ndarray:
    xp = namespace(periods)
    take = xp.take_along_axis if xp is np else xp.take_along_dim
    rows, last, integer = xp.stack(list(past)), len(past) - 1, xp.floor(periods)
    share = periods - integer
    newer, older = (take(rows, xp.asarray((last - integer - k).clip(0), dtype=xp.int64)[None], 0)[0] for k in (0, 1))
    return (1 - share) * newer + share * older


def smooth_direction(speed: np.ndarray) -> np.ndarray:
    """Direction of motion -1..1, smooth through standstill."""
    return namespace(speed).tanh(speed / STICTION_SPEED)


def infinite_where_zero(limit: np.ndarray) -> np.ndarray:
    """A limit, infinite where none (0) is given."""
    return namespace(limit).where(limit > 0, limit, np.inf)
