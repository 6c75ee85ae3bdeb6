"""Stamped streams of poses: an arm's hand, a camera, a marker. Fails closed; stamps that jitter or repeat are normal."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from sim2real.recordings.reading import ContractViolation
from sim2real.thresholds import THRESHOLDS

STREAMS = THRESHOLDS.streams
COLUMNS = 8  # stamp, position x y z, quaternion x y z w


@dataclass(frozen=True, eq=False)
class Stream:
    """Poses of one body in one frame, whatever the two are; their time is that of the stamps.

    time (n,) s, not decreasing; position (n, 3) m; quaternion (n, 4) x y z w, of length 1, each the nearer of its two signs
    to the one before. overtaken: rows that came after one with a later stamp.
    """

    name: str
    time: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    overtaken: int = 0

    @cached_property
    def is_repeated(self) -> np.ndarray:
        """Of each row (n,), whether it says nothing new: the stamp of the row before, or its very pose in a moving stream."""
        pose = np.hstack([self.position, self.quaternion])
        same = np.r_[False, (pose[1:] == pose[:-1]).all(axis=1)]
        run = np.cumsum(~same) - 1
        begin = np.flatnonzero(~same)
        # How fast the pose goes on from each run of equal rows to the next; a metre counts as a radian.
        change = np.linalg.norm(np.diff(pose[begin], axis=0) * [1, 1, 1, 2, 2, 2, 2], axis=1)
        rate = np.r_[change / np.maximum(np.diff(self.time[begin]), 1e-9), 0.0]
        is_moving = rate > STREAMS.moving * np.quantile(rate, STREAMS.fast)
        return (same & is_moving[run]) | np.r_[False, np.diff(self.time) == 0]

    @cached_property
    def period(self) -> float:
        """s, median time between rows that say something new."""
        return float(np.median(np.diff(self.time[~self.is_repeated])))

    @property
    def duration(self) -> float:
        """s from the first row to the last."""
        return float(self.time[-1] - self.time[0])

    def rows(self, which: np.ndarray) -> Stream:
        """The stream of these rows only: indices in order, or a mask (n,)."""
        return Stream(self.name, self.time[which], self.position[which], self.quaternion[which], self.overtaken)

    def shifted(self, offset: float, drift: float = 0.0) -> Stream:
        """The same with stamps that are late by `offset` s, and by `drift` s more for each second since the first row."""
        time = self.time + offset + drift * (self.time - self.time[0])
        return Stream(self.name, time, self.position, self.quaternion, self.overtaken)


def from_arrays(name: str, time: np.ndarray, position: np.ndarray, quaternion: np.ndarray) -> Stream:
    """A stream of time (n,) s, position (n, 3) m and quaternion (n, 4) x y z w. Raises ContractViolation.

    Rows that are stamped a little before the one before them are put in order: messages overtake one another. A clock that
    was set back is refused.
    """
    time, position, quaternion = (np.asarray(values, dtype=float) for values in (time, position, quaternion))
    found = (time.shape, position.shape, quaternion.shape)
    if time.ndim != 1 or found[1:] != ((time.size, 3), (time.size, 4)):
        raise ContractViolation(f"{name}: expected times (n,), positions (n, 3) and quaternions (n, 4), got {found}")
    if time.size < STREAMS.rows:
        raise ContractViolation(f"{name}: expected at least {STREAMS.rows} rows, got {time.size}")
    whole = np.isfinite(np.column_stack([time, position, quaternion])).all(axis=1)
    if not whole.all():
        raise ContractViolation(f"{name}: expected numbers, row {np.argmin(whole)} has one that is not finite")
    length = np.linalg.norm(quaternion, axis=1)
    worst = int(np.argmax(np.abs(length - 1)))
    if abs(length[worst] - 1) > STREAMS.norm:
        raise ContractViolation(
            f"{name}: expected quaternions of length 1, that of row {worst} has {length[worst]:.3g}"
        )
    back = np.maximum.accumulate(time) - time
    if back.max() > STREAMS.overtaken:
        raise ContractViolation(
            f"{name}: expected stamps that go on, row {np.argmax(back)} is {back.max():.3g} s before an earlier row"
        )
    if time.max() == time.min():
        raise ContractViolation(f"{name}: expected stamps that go on, all are {time[0]:g} s")
    period, (least, most) = float(np.median(np.diff(np.unique(time)))), STREAMS.periods
    if not least <= period <= most:
        raise ContractViolation(f"{name}: expected stamps in s, {least:g} to {most:g} s apart, got {period:.3g}")
    order = np.argsort(time, kind="stable")
    turned = quaternion[order] / length[order, None]
    signs = np.where((turned[1:] * turned[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    turned[1:] *= np.cumprod(signs)[:, None]
    return Stream(name, time[order], position[order], turned, int((back > 0).sum()))


def read(source: str | Path) -> Stream:
    """A stream from FILE.npz:NAME, an array (n, 8): stamp s, position x y z m, quaternion x y z w.

    NAME may be left out where the file has one array. Raises ContractViolation.
    """
    path, dot, name = str(source).partition(".npz")
    path, name = Path(path + dot), name.removeprefix(":")
    if not dot or not path.exists():
        raise ContractViolation(f"{source}: expected FILE.npz or FILE.npz:NAME, got no such file")
    try:
        with np.load(path) as arrays:
            names = list(arrays)
            if name not in names and (name or len(names) != 1):
                raise ContractViolation(f"{path}: expected {name or 'the name of one array'}, got {', '.join(names)}")
            values = np.asarray(arrays[name or names[0]], dtype=float)
    except ContractViolation:
        raise
    except (OSError, ValueError, BadZipFile) as error:
        raise ContractViolation(
            f"{path}: expected arrays of numbers as numpy.savez writes them, got: {error}"
        ) from error
    if values.ndim != 2 or values.shape[1] != COLUMNS:
        raise ContractViolation(
            f"{source}: expected rows of {COLUMNS} numbers (stamp, x y z, quaternion x y z w), got {values.shape}"
        )
    return from_arrays(name.rpartition("/")[2] or path.stem, values[:, 0], values[:, 1:4], values[:, 4:])
