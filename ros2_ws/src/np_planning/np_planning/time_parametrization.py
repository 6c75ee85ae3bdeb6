"""From waypoints to a timed trajectory: rounded corners, then the fastest run along the path that limits allow.

The path is a quadratic B-spline with the waypoints as control points (continuous tangent, no stop at a corner). Along it a
forward and a backward pass over the squared path speed give the speed profile (Bobrow et al., 1985, in the discrete
form of Pham and Pham, 2018); curvature may use up half of each acceleration limit.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from np_control.trajectory import Trajectory
from np_planning.rrt import densify

ACCELERATION_LIMIT = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])
"""rad/s^2, the manufacturer's limits for the Panda (Franka Control Interface documentation)."""
_STEP = 0.01  # rad, between samples of the path
_ROUNDINGS = 6  # attempts to keep a rounded corner free of collisions


def round_corners(waypoints, is_free: Callable[[np.ndarray], bool]) -> np.ndarray:
    """Points (m, 7) along a quadratic B-spline from the first to the last waypoint (n, 7), all of them free.

    More control points pull the curve to the polyline, which is free itself: they are added until the curve is, too.
    """
    control = np.asarray(waypoints, float)
    for _ in range(_ROUNDINGS):
        curve = _b_spline(control)
        if all(is_free(joints) for joints in curve):
            return curve
        control = np.insert(control, range(1, len(control)), (control[1:] + control[:-1]) / 2, axis=0)
    return densify(waypoints, _STEP)  # all but stops at corners, where the tangent jumps


def _b_spline(control: np.ndarray) -> np.ndarray:
    """Points about _STEP apart on the clamped quadratic B-spline: a parabola about every inner control point."""
    middle = (control[1:] + control[:-1]) / 2
    knots = [control[0], *middle[1:-1], control[-1]]
    if len(control) < 3:
        return densify(control, _STEP)
    points = [control[:1]]
    for a, b, c in zip(knots, control[1:-1], knots[1:]):
        steps = max(2, int(np.ceil((np.linalg.norm(b - a) + np.linalg.norm(c - b)) / _STEP)))
        t = np.linspace(0, 1, steps + 1)[1:, None]
        points.append((1 - t) ** 2 * a + 2 * t * (1 - t) * b + t**2 * c)
    return np.concatenate(points)


def parametrize_path(path, velocity_limit, acceleration_limit, period: float = 0.02) -> Trajectory:
    """The fastest trajectory along `path` (m, 7) rad, from rest to rest, sampled every `period` s.

    velocity_limit (7,) rad/s, acceleration_limit (7,) rad/s^2. Raises ValueError for a path without length.
    """
    path = np.asarray(path, float)
    chords = np.linalg.norm(np.diff(path, axis=0), axis=1)
    path, chords = path[np.concatenate([[True], chords > 1e-9])], chords[chords > 1e-9]
    if not len(chords):
        raise ValueError("retime: expected a path with at least two different points")
    s = np.concatenate([[0.0], np.cumsum(chords)])
    # Resampled evenly, so that finite differences are derivatives.
    even = np.linspace(0.0, s[-1], max(8, int(np.ceil(s[-1] / _STEP)) + 1))
    path = np.stack([np.interp(even, s, column) for column in path.T], axis=1)
    ds = even[1]
    tangent = np.gradient(path, ds, axis=0)
    curvature = np.gradient(tangent, ds, axis=0)
    tiny = 1e-9
    squared = np.minimum(
        (velocity_limit / (np.abs(tangent) + tiny)).min(axis=1) ** 2,
        (acceleration_limit / 2 / (np.abs(curvature) + tiny)).min(axis=1),
    )
    left = acceleration_limit - np.abs(curvature) * squared[:, None]  # for speeding up and down
    gain = (left / (np.abs(tangent) + tiny)).min(axis=1)
    squared[[0, -1]] = 0.0
    for order in (range(1, len(even)), range(len(even) - 2, -1, -1)):
        for i in order:
            before = i - 1 if order.step > 0 else i + 1
            squared[i] = min(squared[i], squared[before] + 2 * ds * min(gain[i], gain[before]))
    speed = np.sqrt(squared)
    # Constant acceleration between samples: the time of a step is its length over the mean of both speeds.
    times = np.concatenate([[0.0], np.cumsum(2 * ds / (speed[1:] + speed[:-1]))])
    return _sample(times, even, speed, path, tangent, period)


def _sample(times, s, speed, path, tangent, period: float) -> Trajectory:
    count = max(2, int(np.ceil(times[-1] / period)) + 1)
    at = np.linspace(0.0, times[-1], count)
    i = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    elapsed = at - times[i]
    acceleration = (speed[i + 1] - speed[i]) / (times[i + 1] - times[i])
    where = s[i] + speed[i] * elapsed + acceleration * elapsed**2 / 2
    rate = speed[i] + acceleration * elapsed
    positions = np.stack([np.interp(where, s, column) for column in path.T], axis=1)
    velocities = np.stack([np.interp(where, s, column) for column in tangent.T], axis=1) * rate[:, None]
    positions[0], positions[-1] = path[0], path[-1]
    velocities[[0, -1]] = 0.0
    return Trajectory(at, positions, velocities)


def join_trajectories(first: Trajectory, second: Trajectory) -> Trajectory:
    """`second` after `first`, which ends at rest where `second` begins."""
    return Trajectory(
        np.concatenate([first.times, first.duration + second.times[1:]]),
        np.concatenate([first.positions, second.positions[1:]]),
        np.concatenate([first.velocities, second.velocities[1:]]),
    )
