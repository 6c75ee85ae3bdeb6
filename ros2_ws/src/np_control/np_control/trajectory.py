"""Joint trajectories: points with positions and velocities, sampled by cubic Hermite interpolation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_control.safety import Reason, Refusal, SafetyLimits


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A joint trajectory. Between points the position is the cubic that meets both positions and velocities; outside, the arm rests at the first or last point."""

    times: np.ndarray
    """Times from the start (n,) s, n >= 1, increasing."""
    positions: np.ndarray
    """Joints (n, 7) rad."""
    velocities: np.ndarray
    """Velocities (n, 7) rad/s."""

    @property
    def duration(self) -> float:
        """Time s of the last point."""
        return float(self.times[-1])

    def sample(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Position (7,) rad and velocity (7,) rad/s at `time` s."""
        position, velocity, _ = self.sample_with_acceleration(time)
        return position, velocity

    def sample_with_acceleration(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position (7,) rad, velocity (7,) rad/s and acceleration (7,) rad/s^2 at `time` s."""
        times, rest = self.times, np.zeros(self.positions.shape[1])
        if time < times[0] or len(times) == 1:
            return self.positions[0], rest, rest
        if time >= times[-1]:
            return self.positions[-1], rest, rest
        k = int(np.searchsorted(times, time, side="right")) - 1
        span = times[k + 1] - times[k]
        s = (time - times[k]) / span
        c0, c1, c2, c3 = self._cubic(k, k + 1, span)
        position = c0 + s * (c1 + s * (c2 + s * c3))
        velocity = (c1 + s * (2 * c2 + s * 3 * c3)) / span
        acceleration = (2 * c2 + 6 * s * c3) / span**2
        return position, velocity, acceleration

    def extremes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Least, greatest position (7,) rad and greatest speed (7,) rad/s anywhere on the way, exactly."""
        lower, upper = self.positions.min(axis=0), self.positions.max(axis=0)
        speed = np.abs(self.velocities).max(axis=0)
        if len(self.times) == 1:
            return lower, upper, speed
        spans = np.diff(self.times)[:, None]
        c0, c1, c2, c3 = self._cubic(slice(-1), slice(1, None), spans)  # of all segments at once
        with np.errstate(divide="ignore", invalid="ignore"):
            fastest = -c2 / (3 * c3)  # where the velocity, a parabola, peaks
            root = np.sqrt(c2 * c2 - 3 * c1 * c3)
            # Where the velocity is zero. The two forms avoid cancellation for either sign of c2.
            q = -(c2 + np.copysign(root, c2))
            stationary = (q / (3 * c3), c1 / q)
        for s in stationary:
            s = np.where((s > 0) & (s < 1), s, 0.0)
            at = c0 + s * (c1 + s * (c2 + s * c3))
            lower, upper = np.minimum(lower, at.min(axis=0)), np.maximum(upper, at.max(axis=0))
        s = np.where((fastest > 0) & (fastest < 1), fastest, 0.0)
        speed = np.maximum(speed, (np.abs(c1 + s * (2 * c2 + s * 3 * c3)) / spans).max(axis=0))
        return lower, upper, speed

    def _cubic(self, first, second, span) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Coefficients of the cubics in s = 0..1 from points `first` to points `second` (indices), `span` s
        apart.
        """
        p0, p1 = self.positions[first], self.positions[second]
        v0, v1 = self.velocities[first] * span, self.velocities[second] * span
        return p0, v0, 3 * (p1 - p0) - 2 * v0 - v1, 2 * (p0 - p1) + v0 + v1


def make_trajectory(
    times: np.ndarray, positions: np.ndarray, velocities: np.ndarray, limits: SafetyLimits
) -> Trajectory:
    """A checked trajectory that starts and ends at rest.

    Raises Refusal: trajectory (no points, shapes, times that do not increase, motion at either end),
    not_finite, position or velocity (anywhere on it; the speed allowed is `speed_fraction` of the limit).
    """
    times, positions, velocities = (np.array(a, dtype=float) for a in (times, positions, velocities))
    joints = len(limits.joints)
    if times.ndim != 1 or times.size == 0:
        raise Refusal(Reason.TRAJECTORY, f"expected at least one point, got times of shape {times.shape}")
    for name, table in (("positions", positions), ("velocities", velocities)):
        if table.shape != (times.size, joints):
            raise Refusal(Reason.TRAJECTORY, f"{name}: expected shape {(times.size, joints)}, got {table.shape}")
        if not np.isfinite(table).all():
            raise Refusal(Reason.NOT_FINITE, f"{name}: expected finite numbers")
    if not np.isfinite(times).all() or times[0] < 0 or (np.diff(times) <= 0).any():
        raise Refusal(Reason.TRAJECTORY, f"times: expected increasing from 0 or later, got {times}")
    if np.abs(velocities[[0, -1]]).max() > 1e-3:
        raise Refusal(
            Reason.TRAJECTORY, f"expected rest at both ends, got velocities {velocities[0]} and {velocities[-1]} rad/s"
        )
    trajectory = Trajectory(times, positions, velocities)
    lower, upper, speed = trajectory.extremes()
    for i in np.flatnonzero((lower < limits.position_lower) | (upper > limits.position_upper)):
        raise Refusal(
            Reason.POSITION,
            f"{limits.joints[i]}: expected {limits.position_lower[i]} to "
            f"{limits.position_upper[i]} rad, got {lower[i]:.4f} to {upper[i]:.4f}",
        )
    allowed = limits.speed_fraction * limits.velocity
    for i in np.flatnonzero(speed > allowed):
        raise Refusal(
            Reason.VELOCITY, f"{limits.joints[i]}: expected at most {allowed[i]:.3f} rad/s, got {speed[i]:.3f}"
        )
    return trajectory
