"""Whether numbers can be what they claim: units, signs and order of the joints, judged by physics."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from np_description.panda import NOMINAL, PandaModel

from np_diagnosis.nominal import STANDSTILL, expected_torque
from np_diagnosis.reading import ContractViolation
from np_diagnosis.signals import Log, Samples, sample

RANGE_SLACK = 0.05  # rad beyond the joint limits
SPEED_SLACK = 1.5  # times the speed limit
ROWS = 300  # samples that the dynamics are tried on
DECISIVE = 3.0  # nats a joint's log residual energy must fall by under a transposition or reversed sign
SLOPE = (0.7, 1.4)  # of the derivative of position against velocity


def check(log: Log, panda: PandaModel = NOMINAL) -> None:
    """Raise ContractViolation for a log in other units, with reversed signs or swapped joints."""
    _check_range(log, panda)
    _check_velocity(log, panda)
    _check_torque(log, panda)


def _check_range(log: Log, panda: PandaModel) -> None:
    for j, joint in enumerate(panda.joints):
        low, high = log.position[:, j].min(), log.position[:, j].max()
        lower, upper = panda.position_lower[j], panda.position_upper[j]
        if low < lower - RANGE_SLACK or high > upper + RANGE_SLACK:
            hint = _hint(np.radians([low, high]), np.array([-high, -low]), lower, upper)
            raise ContractViolation(
                f"{log.name}: position of {joint}: expected {lower} to {upper} rad, "
                f"got {low:.3f} to {high:.3f}{hint}"
            )
        fastest, limit = np.abs(log.velocity[:, j]).max(), SPEED_SLACK * panda.velocity_limit[j]
        if fastest > limit:
            raise ContractViolation(
                f"{log.name}: velocity of {joint}: expected at most {limit:.2f} rad/s, got "
                f"{fastest:.2f}{' (degrees?)' if np.radians(fastest) < limit else ''}"
            )


def _hint(in_radians: np.ndarray, reversed_sign: np.ndarray, lower: float, upper: float) -> str:
    for bounds, text in ((in_radians, " (degrees?)"), (reversed_sign, " (reversed sign?)")):
        if bounds[0] >= lower - RANGE_SLACK and bounds[1] <= upper + RANGE_SLACK:
            return text
    return ""


def _check_velocity(log: Log, panda: PandaModel) -> None:
    """Velocity is the derivative of position."""
    step = max(1, round(0.01 / np.median(np.diff(log.time))))
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
    for j, joint in enumerate(panda.joints):
        if derived[:, j].std() < STANDSTILL and measured[:, j].std() < STANDSTILL:
            continue
        energy = (measured[:, j] ** 2).sum()
        slope = (measured[:, j] * derived[:, j]).sum() / energy if energy > 0 else np.inf
        if not SLOPE[0] < slope < SLOPE[1]:
            raise ContractViolation(
                f"{log.name}: velocity of {joint}: expected the derivative of position, which "
                f"is {slope:.3g} times what was found: wrong unit, sign or joint"
            )


def _check_torque(log: Log, panda: PandaModel) -> None:
    """No exchange of joints or signs explains the torques far better than the names given."""
    samples = _thinned(sample([log]))
    given = _residual_energy(samples, panda)
    count = len(panda.joints)
    same = np.arange(count)
    for what, channels in (
        ("torque", ("torque",)),
        ("position, velocity and torque", ("position", "velocity", "acceleration", "torque")),
    ):
        trials = []
        for j in range(count):
            flip = np.ones(count)
            flip[j] = -1
            trials.append((f"of {panda.joints[j]} with reversed sign", (j,), same, flip))
        for i, k in combinations(range(count), 2):
            order = same.copy()
            order[[i, k]] = order[[k, i]]
            trials.append(
                (f"of {panda.joints[i]} and {panda.joints[k]} exchanged", (i, k), order, np.ones(count))
            )
        for text, joints, order, flip in trials:
            changed = replace(samples, **{name: getattr(samples, name)[:, order] * flip for name in channels})
            fall = given - _residual_energy(changed, panda)
            if fall[list(joints)].min() > DECISIVE and fall.sum() > DECISIVE:
                raise ContractViolation(
                    f"{log.name}: {what}: expected torques of the nominal arm in the order of its joints, "
                    f"found that {what} {text} fit {np.exp(fall[list(joints)].min() / 2):.0f} times better"
                )


def _thinned(samples: Samples) -> Samples:
    """At most ROWS samples, those with most motion."""
    speed = np.abs(samples.velocity).max(axis=1)
    moving = np.flatnonzero(speed > STANDSTILL)
    kept = (
        moving[np.linspace(0, moving.size - 1, min(ROWS, moving.size)).astype(int)] if moving.size else moving
    )
    return replace(
        samples,
        **{
            name: getattr(samples, name)[kept]
            for name in (
                "time",
                "trajectory",
                "position",
                "velocity",
                "acceleration",
                "torque",
                "torque_rate",
            )
        },
    )


def _residual_energy(samples: Samples, panda: PandaModel) -> np.ndarray:
    """Log of the mean square residual (7,) of each joint, offsets allowed."""
    if not len(samples):
        return np.zeros(len(panda.joints))
    residual = samples.torque - expected_torque(samples, panda)
    # An error of a thousandth of the torque limit is none.
    return np.log(residual.var(axis=0) + (1e-3 * panda.torque_limit) ** 2)
