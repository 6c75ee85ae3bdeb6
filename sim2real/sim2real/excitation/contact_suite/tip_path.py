"""Paths of the fingertips as segments of joint trajectories: straight legs at constant speed, with rests between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from np_control.impedance import STIFFNESS_MAX
from np_control.kinematics import forward_kinematics, jacobian, pose_distance, solve_ik
from np_control.safety import LIMITS
from np_control.trajectory import make_trajectory
from np_description.panda import NOMINAL
from sim2real.excitation.contact_suite.tip import BEYOND, upright_rotation
from sim2real.excitation.motions import least_jerk
from sim2real.excitation.suite import Segment, make_transfer

RATE = 100.0  # knots a second
RAMP = 0.12  # s, in which a leg reaches its speed
MISSES = 5e-4, 2e-3  # m, rad: by which inverse kinematics may miss a knot
GAINS = np.stack([STIFFNESS_MAX, np.ones(7)])


class OutOfReach(ValueError):
    """A path that the arm cannot follow; the message names the place."""


@dataclass(frozen=True, eq=False)
class Leg:
    """A straight path of the tip's end."""

    end: np.ndarray
    """(3,) m."""
    speed: float
    """m/s."""
    rest: float = 0.0
    """s of rest after it."""
    ramp: float = RAMP
    """s in which the speed is reached."""
    stop: float = RAMP
    """s in which the tip comes to rest."""


@dataclass(frozen=True, eq=False)
class Oscillation:
    """A sinusoid about the tip's place, which grows from rest within half a period and ends likewise."""

    way: np.ndarray
    """(3,) m, amplitude."""
    period: float
    """s."""
    count: int
    """Number of periods."""
    rest: float = 0.0
    """s of rest after it."""


def make_segment(name: str, begin: np.ndarray, legs: Sequence[Leg | Oscillation], yaw: float) -> Segment:
    """The legs from `begin` (3,) m, the tip's end, with the hand upright at a yaw rad and the elbow over the line from the base to it. Raises
    OutOfReach."""
    points = [np.asarray(begin, float)[None]]
    for leg in legs:
        points.append((_oscillation_points if isinstance(leg, Oscillation) else _leg_points)(points[-1][-1], leg))
    path, rotation = np.concatenate(points) + [0.0, 0.0, BEYOND], upright_rotation(yaw)
    positions, q = [], _initial_posture(path[0], yaw)
    for number, point in enumerate(path):
        q = solve_ik(q, point, rotation, iterations=30 if number == 0 else 4, damping=0.01)
        away = np.array(pose_distance(q, point, rotation))
        if (away > MISSES).any() or (q < LIMITS.wall_lower).any() or (q > LIMITS.wall_upper).any():
            raise OutOfReach(
                f"{name}: the tip cannot be at {np.round(point, 3)} m, upright with a yaw of {yaw:.2f} rad"
            )
        positions.append(q)
    positions = np.array(positions)
    times = np.arange(len(positions)) / RATE
    velocities = CubicSpline(times, positions, bc_type="clamped")(times, 1)
    try:
        make_trajectory(times, positions, velocities, LIMITS)
    except ValueError as error:  # a Refusal is one
        raise OutOfReach(f"{name}: {error}") from error
    return Segment(name, times, positions, velocities, GAINS)


def _initial_posture(point: np.ndarray, yaw: float) -> np.ndarray:
    """The ready posture (7,) rad, turned to where T_E is to be, (3,) m, with a hand at a yaw rad.

    Whatever the arm has done before: an inverse kinematics that goes on from where it rests lets the elbow drift aside, by 1 rad in some touches,
    and there the same lead of a target presses three times as hard.
    """
    ahead = float(np.arctan2(point[1], point[0]))
    return NOMINAL.ready + np.array([ahead, 0.0, 0.0, 0.0, 0.0, 0.0, ahead - yaw])


def rest_segment(name: str, q: np.ndarray, seconds: float) -> Segment:
    """Rest at joints (7,) rad."""
    times = np.linspace(0.0, seconds, int(seconds * 10) + 1)
    return Segment(name, times, np.tile(q, (len(times), 1)), np.zeros((len(times), 7)), GAINS)


def join_segments(q: np.ndarray, segments: Sequence[Segment]) -> list[Segment]:
    """The segments, with a transfer from joints (7,) rad to each that begins elsewhere."""
    plan = []
    for one in segments:
        if not np.allclose(q, one.positions[0], rtol=0.0, atol=1e-6):
            plan.append(make_transfer(q, one.positions[0]))
        plan.append(one)
        q = one.positions[-1]
    return plan


def tip_position(q: np.ndarray) -> np.ndarray:
    """The tip's end (3,) m at joints (7,) rad."""
    position, rotation = forward_kinematics(q)
    return position + rotation @ [0.0, 0.0, BEYOND]


def press_depth(q: np.ndarray, force: float) -> float:
    """m below a surface at which the tip's target makes the arm press down on it with `force` N, at joints (7,) rad."""
    linear = jacobian(q)[:3]
    return force * float((linear / STIFFNESS_MAX @ linear.T)[2, 2])


def _leg_points(start: np.ndarray, leg: Leg) -> np.ndarray:
    """Points (n, 3) m of a leg after its start, one a knot."""
    length = float(np.linalg.norm(leg.end - start))
    # Ramps of a leg that is too short for them are shorter, and its speed is lower.
    speed = min(leg.speed, length / (0.5 * (leg.ramp + leg.stop)) * 0.9) if length else 0.0
    duration = length / speed + 0.5 * (leg.ramp + leg.stop) if speed else 0.0
    count = int(np.ceil(duration * RATE))
    fine = np.linspace(0.0, duration, 20 * count + 1)
    pace = np.minimum(least_jerk(fine / leg.ramp)[0], least_jerk((duration - fine) / leg.stop)[0])
    distance = np.concatenate([[0.0], np.cumsum(np.diff(fine) * (pace[1:] + pace[:-1]) / 2)])
    share = (
        np.interp(np.linspace(0.0, duration, count + 1)[1:], fine, distance / distance[-1]) if count else np.zeros(0)
    )
    rest = np.ones(round(leg.rest * RATE))
    return start + np.concatenate([share, rest])[:, None] * (leg.end - start)


def _oscillation_points(start: np.ndarray, swing: Oscillation) -> np.ndarray:
    """Points (n, 3) m, one a knot."""
    duration = swing.count * swing.period
    time = np.arange(1, round(duration * RATE) + 1) / RATE
    grown = np.minimum(*(least_jerk(t / (swing.period / 2))[0] for t in (time, duration - time)))
    share = np.concatenate([grown * np.sin(2 * np.pi * time / swing.period), np.zeros(round(swing.rest * RATE))])
    return start + share[:, None] * swing.way
