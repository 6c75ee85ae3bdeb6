"""A recording of a planar push, and the windows of it in which the object slides in front of the tip.

Each stream has stamps of its own. A window is a tenth of a second: what the force sensor hears of the arm's own vibration has
gone from its mean, and clocks that are some milliseconds apart do not matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from sim2real.thresholds import THRESHOLDS

PUSHING = THRESHOLDS.pushing


@dataclass(frozen=True, eq=False)
class Push:
    """One push in the world's frame, table horizontal; stamps of a stream increase.

    force (n, 2) N on the object at force_time (n,) s; tip (m, 2) m, centre of the round tip, at tip_time (m,) s; position
    (k, 2) m and yaw (k,) rad without jumps of the object's frame at object_time (k,) s. tip_radius: m.
    """

    name: str
    force_time: np.ndarray
    force: np.ndarray
    tip_time: np.ndarray
    tip: np.ndarray
    object_time: np.ndarray
    position: np.ndarray
    yaw: np.ndarray
    tip_radius: float


@dataclass(frozen=True, eq=False)
class Windows:
    """A push in w windows of sliding contact, all in the world's frame but `face`.

    time (w,) s; position (w, 2) m, yaw (w,) rad, velocity (w, 2) m/s and rate (w,) rad/s of the object's frame; tip (w, 2) m
    and tip_velocity (w, 2) m/s; force (w, 2) N on the object, without the sensor's bias. face (w, 2): outward normal of the
    face that is pushed, in the object's frame, the same in each; tip_radius (w,) m.
    """

    name: str
    time: np.ndarray
    position: np.ndarray
    yaw: np.ndarray
    velocity: np.ndarray
    rate: np.ndarray
    tip: np.ndarray
    tip_velocity: np.ndarray
    force: np.ndarray
    face: np.ndarray
    tip_radius: np.ndarray


def read_push(
    name: str, force: np.ndarray, tip: np.ndarray, pose: np.ndarray, turn: np.ndarray, tip_radius: float
) -> Push:
    """A push from arrays whose first column is the stamp in s.

    force (n, 4): reading of the sensor, N. tip (m, 4): m, world. pose (k, 8): position m, world, and quaternion x y z w.
    turn (3, 3): what makes of a reading the force on the object in the world's frame: a rotation, or minus one where the
    sensor gives the reaction. Raises ValueError for anything else, in words.
    """
    streams = {"force": (force, 4), "tip": (tip, 4), "object": (pose, 8)}
    for stream, (values, columns) in streams.items():
        _check(name, stream, np.asarray(values), columns)
    if np.shape(turn) != (3, 3) or not np.allclose(np.asarray(turn) @ np.transpose(turn), np.eye(3), atol=1e-6):
        raise ValueError(
            f"push {name}: expected an orthogonal turn (3, 3) of the force, got {np.asarray(turn).tolist()}"
        )
    quaternion = pose[:, 4:]
    length = np.linalg.norm(quaternion, axis=1)
    if np.abs(length - 1).max() > PUSHING.unit:
        raise ValueError(f"push {name}: expected unit quaternions of the object, got a length of {length.min():.3g}")
    x, y, z, w = (quaternion / length[:, None]).T
    yaw = np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    in_world = force[:, 1:] @ np.asarray(turn).T
    return Push(name, force[:, 0], in_world[:, :2], tip[:, 0], tip[:, 1:3], pose[:, 0], pose[:, 1:3], yaw, tip_radius)


def _check(name: str, stream: str, values: np.ndarray, columns: int) -> None:
    """Raises ValueError where a stream is not (n, columns) of finite numbers with stamps that increase."""
    where = f"push {name}: {stream}"
    if values.ndim != 2 or values.shape[1] != columns or len(values) < PUSHING.least_rows:
        raise ValueError(f"{where}: expected ({PUSHING.least_rows} or more, {columns}) numbers, got {values.shape}")
    if not np.isfinite(values).all():
        row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
        raise ValueError(f"{where}: expected finite numbers, got {values[row].tolist()} in row {row}")
    step = np.diff(values[:, 0])
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 1
        raise ValueError(f"{where}: expected stamps that increase, got {step[row - 1]:.4g} s before row {row}")


def windows(push: Push) -> Windows:
    """The windows of a push. Raises ValueError, in words, where nothing is pushed or moved, or too little of it."""
    start = max(push.force_time[0], push.tip_time[0], push.object_time[0])
    end = min(push.force_time[-1], push.tip_time[-1], push.object_time[-1])
    if end - start < PUSHING.free + PUSHING.least_windows * PUSHING.window:
        raise ValueError(f"push {push.name}: expected streams of one time, got {max(end - start, 0):.2f} s in common")
    free, bias, noise = _before_contact(push)
    force = push.force - bias
    shown = np.hypot(*uniform_filter1d(force, _rows(push.force_time, PUSHING.window), axis=0).T)
    if shown.max() < max(PUSHING.onset * noise, PUSHING.least_force):
        raise ValueError(
            f"push {push.name}: expected contact, got a force of {shown.max():.2g} N in noise of {noise:.2g} N"
        )
    centres = np.arange(free + PUSHING.window / 2, end - PUSHING.window / 2, PUSHING.window)
    motion = np.column_stack([push.position, push.yaw])
    pose, twist = _lines(push.object_time, motion, centres)
    if not len(centres) or np.hypot(*twist[:, :2].T).max() < PUSHING.least_speed:
        fastest = np.hypot(*twist[:, :2].T).max() if len(centres) else 0.0
        raise ValueError(f"push {push.name}: expected an object that moves, got at most {1e3 * fastest:.2g} mm/s")
    tip, tip_velocity = _lines(push.tip_time, push.tip, centres)
    mean, _ = _lines(push.force_time, force, centres)
    kept = _sliding(mean, np.hypot(*twist[:, :2].T))
    if kept.sum() < PUSHING.least_windows:
        raise ValueError(
            f"push {push.name}: expected {PUSHING.least_windows} windows of sliding contact, got {kept.sum()}"
        )
    kept_pose, kept_force = pose[kept], mean[kept]
    return Windows(
        push.name,
        centres[kept],
        kept_pose[:, :2],
        kept_pose[:, 2],
        twist[kept, :2],
        twist[kept, 2],
        tip[kept],
        tip_velocity[kept],
        kept_force,
        np.tile(_face(kept_force, kept_pose[:, 2]), (kept.sum(), 1)),
        np.full(kept.sum(), push.tip_radius),
    )


def _before_contact(push: Push) -> tuple[float, np.ndarray, float]:
    """End of the free part in s, bias (2,) N and noise N of a reading in its first part. Raises ValueError if it is short."""
    time, first = push.force_time, push.force_time[0]
    begin = time < first + PUSHING.free
    noise = float(np.sqrt(np.mean(np.var(push.force[begin], axis=0)))) + 1e-9
    moved = np.hypot(*(push.position - push.position[push.object_time < first + PUSHING.free].mean(axis=0)).T)
    onset = push.object_time[np.argmax(moved > PUSHING.moved)] if (moved > PUSHING.moved).any() else time[-1]
    if onset < first + PUSHING.free:
        raise ValueError(
            f"push {push.name}: expected {PUSHING.free} s without contact at the beginning, got {max(onset - first, 0):.2f} s"
        )
    return float(onset), push.force[begin].mean(axis=0), noise


def _rows(time: np.ndarray, duration: float) -> int:
    return max(1, round(duration / float(np.median(np.diff(time)))))


def _lines(time: np.ndarray, values: np.ndarray, centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Value and rate (w, c) at the centres of windows, of straight lines through the values (n, c) in each."""
    level, slope = np.full((2, len(centres), values.shape[1]), np.nan)
    for n, centre in enumerate(centres):
        first, last = np.searchsorted(time, [centre - PUSHING.window / 2, centre + PUSHING.window / 2])
        if last - first >= PUSHING.least_in_window:
            slope[n], level[n] = np.polyfit(time[first:last] - centre, values[first:last], 1)
    return level, slope


def _sliding(force: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Windows (w,) bool of the longest stretch with force and motion, less those in which contact begins or ends."""
    size = np.hypot(*force.T)
    usual = np.nanmedian(size[speed > PUSHING.least_speed])
    on = (speed > PUSHING.least_speed) & (size > PUSHING.contact_share * usual)
    edges = np.flatnonzero(np.diff(np.r_[False, on, False].astype(int))).reshape(-1, 2)
    if not len(edges):
        return on
    first, last = edges[np.argmax(edges[:, 1] - edges[:, 0])]
    kept = np.zeros(len(on), dtype=bool)
    kept[first + PUSHING.settling : max(last - PUSHING.leaving, first)] = True
    return kept


def _face(force: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Outward normal (2,) of the square's face that is pushed, in its frame: against the force, at the beginning."""
    rows = slice(0, PUSHING.least_windows)
    turned = np.arctan2(force[rows, 1], force[rows, 0]) - yaw[rows] + np.pi
    angle = np.angle(np.exp(1j * turned).mean())
    quarter = np.round(angle / (np.pi / 2)) * np.pi / 2
    return np.round([np.cos(quarter), np.sin(quarter)])
