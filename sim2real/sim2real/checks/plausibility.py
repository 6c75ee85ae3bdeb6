"""Whether numbers can be what they claim: units, signs and order of the joints, judged by physics."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from sim2real.arm.model import Arm, panda
from sim2real.arm.nominal_prediction import predict_expected_torque
from sim2real.recordings.reading import ContractViolation
from sim2real.recordings.signals import Log, Samples, sample_logs
from sim2real.thresholds import THRESHOLDS

PLAUSIBILITY = THRESHOLDS.plausibility


def check_plausibility(log: Log, arm: Arm | None = None) -> None:
    """Raise ContractViolation for a log in other units, with reversed signs or swapped joints."""
    arm = arm or panda()
    _check_range(log, arm)
    _check_velocity(log, arm)
    samples = sample_logs([log])
    rows = _most_motion(samples)
    if rows.size:
        _check_speed(log, arm, samples, rows)
        _check_torque(log, arm, samples, rows)


def _check_range(log: Log, arm: Arm) -> None:
    for j, joint in enumerate(arm.joints):
        low, high = log.position[:, j].min(), log.position[:, j].max()
        lower, upper = arm.position_lower[j], arm.position_upper[j]
        if low < lower - PLAUSIBILITY.range_slack or high > upper + PLAUSIBILITY.range_slack:
            hint = _hint(np.radians([low, high]), np.array([-high, -low]), lower, upper)
            raise ContractViolation(
                f"{log.name}: position of {joint}: expected {lower} to {upper} rad, got {low:.3f} to {high:.3f}{hint}"
            )


def _hint(in_radians: np.ndarray, reversed_sign: np.ndarray, lower: float, upper: float) -> str:
    for bounds, text in ((in_radians, " (degrees?)"), (reversed_sign, " (reversed sign?)")):
        if bounds[0] >= lower - PLAUSIBILITY.range_slack and bounds[1] <= upper + PLAUSIBILITY.range_slack:
            return text
    return ""


def _check_velocity(log: Log, arm: Arm) -> None:
    """Velocity is the derivative of position."""
    step = max(1, round(PLAUSIBILITY.velocity_step / np.median(np.diff(log.time))))
    time = log.time[::step]
    derived = np.diff(log.position[::step], axis=0) / np.diff(time)[:, None]
    # The mean velocity over each step, by the trapezoidal rule on the full rate.
    area = np.vstack(
        [
            np.zeros(log.velocity.shape[1]),
            np.cumsum(0.5 * (log.velocity[1:] + log.velocity[:-1]) * np.diff(log.time)[:, None], axis=0),
        ]
    )
    measured = np.diff(area[::step], axis=0) / np.diff(time)[:, None]
    for j, joint in enumerate(arm.joints):
        if derived[:, j].std() < THRESHOLDS.rows.standstill and measured[:, j].std() < THRESHOLDS.rows.standstill:
            continue
        energy = (measured[:, j] ** 2).sum()
        slope = (measured[:, j] * derived[:, j]).sum() / energy if energy > 0 else np.inf
        if not PLAUSIBILITY.slope[0] < slope < PLAUSIBILITY.slope[1]:
            raise ContractViolation(
                f"{log.name}: velocity of {joint}: expected the derivative of position, which "
                f"is {slope:.3g} times what was found: wrong unit"
                f"{' (degrees?)' if _is_radian(slope) else ''}, "
                "sign or joint"
            )


def _is_radian(slope: float) -> bool:
    return PLAUSIBILITY.slope[0] < np.degrees(slope) < PLAUSIBILITY.slope[1]


def _check_speed(log: Log, arm: Arm, samples: Samples, rows: np.ndarray) -> None:
    """A joint beyond its speed moves in degrees, if the torques show it: an arm that swings is too fast, and no
    violation."""
    for j, joint in enumerate(arm.joints):
        fastest, limit = (
            np.percentile(np.abs(log.velocity[:, j]), PLAUSIBILITY.speed_percentile),
            PLAUSIBILITY.speed_slack * arm.velocity_limit[j],
        )
        if fastest <= limit:
            continue
        position, velocity, acceleration = (
            getattr(samples, name)[rows] for name in ("position", "velocity", "acceleration")
        )
        left = []
        for unit in (1.0, np.radians(1.0)):
            factor = np.where(np.arange(len(arm)) == j, unit, 1.0)
            moved = predict_expected_torque(
                position * factor, velocity * factor, acceleration * factor, arm, samples.with_gravity
            )
            error = (PLAUSIBILITY.torque_error * arm.torque_limit[j]) ** 2
            left.append(np.log((samples.torque[rows, j] - moved[:, j]).var() + error))
        if left[0] - left[1] > PLAUSIBILITY.decisive:
            raise ContractViolation(
                f"{log.name}: velocity of {joint}: expected at most {limit:.2f} rad/s, got "
                f"{fastest:.2f} (degrees?): in degrees its torques fit {np.exp((left[0] - left[1]) / 2):.0f} times better"
            )


def _check_torque(log: Log, arm: Arm, samples: Samples, rows: np.ndarray) -> None:
    """No exchange of joints or signs explains the torques far better than the names given."""
    count = len(arm)
    same, plain = np.arange(count), np.ones(count)
    trials = [("", (), same, plain)]
    for j in range(count):
        flip = plain.copy()
        flip[j] = -1
        trials.append((f"of {arm.joints[j]} with reversed sign", (j,), same, flip))
    for i, k in combinations(range(count), 2):
        order = same.copy()
        order[[i, k]] = order[[k, i]]
        trials.append((f"of {arm.joints[i]} and {arm.joints[k]} exchanged", (i, k), order, plain))
    channels = [getattr(samples, name)[rows] for name in ("position", "velocity", "acceleration")]
    torque = samples.torque[rows]

    def tried(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values[:, order] * flip for _, _, order, flip in trials])

    moved = predict_expected_torque(*map(tried, channels), arm, samples.with_gravity).reshape(
        len(trials), *torque.shape
    )
    answered = tried(torque).reshape(moved.shape)
    for what, residual in (
        ("torque", answered - moved[0]),
        ("position, velocity and torque", answered - moved),
    ):
        # Offsets are allowed: what counts is how much the residual varies.
        energy = np.log(residual.var(axis=1) + (PLAUSIBILITY.torque_error * arm.torque_limit) ** 2)
        for (text, joints, _, _), fall in zip(trials[1:], energy[0] - energy[1:]):
            if fall[list(joints)].min() > PLAUSIBILITY.decisive and fall.sum() > PLAUSIBILITY.decisive:
                raise ContractViolation(
                    f"{log.name}: {what}: expected torques of the nominal arm in the order of its joints, "
                    f"found that {what} {text} fit {np.exp(fall[list(joints)].min() / 2):.0f} times better"
                )


def _most_motion(samples: Samples) -> np.ndarray:
    """At most `rows` rows in which something moves."""
    moving = np.flatnonzero(np.abs(samples.velocity).max(axis=1) > THRESHOLDS.rows.standstill)
    return (
        moving[np.linspace(0, moving.size - 1, min(PLAUSIBILITY.rows, moving.size)).astype(int)]
        if moving.size
        else moving
    )
