"""The excitation suite: named motions that together make every effect of the arm visible, and plans of them.

A plan is sent as joint trajectories, one a segment, with gains of its own, through the topics and guards that
any motion takes. Each segment keeps well inside the limits of position, speed and torque (tests/sim2real).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from np_control.impedance import STIFFNESS_MAX
from np_control.safety import LIMITS
from np_control.trajectory import Trajectory, make_trajectory
from np_description.panda import NOMINAL
from sim2real.excitation.motions import Motion, chirp, least_jerk, triangle, visits, waves

TICK_NS = 100_000_000  # policy period: segments begin at multiples of it
PAUSE = 0.2  # s of rest before each segment, at least
TRANSFER_SPEED = 0.8  # rad/s, greatest on the way between postures
SHORTEST_TRANSFER = 1.0  # s
READY = NOMINAL.ready
# Gravity turns its sign on joints 2 and 4 to 6 between these, and the wrist carries its load sideways.
SECOND = np.array([0.5, 0.35, -0.5, -1.2, 0.9, 1.1, -0.4])
THIRD = np.array([-0.6, -1.2, 0.6, -0.7, -1.0, 2.8, 1.5])
SCALE = np.array([1.0, 0.8, 1.0, 0.8, 1.1, 1.1, 1.3])  # of a motion, joint by joint
LOW_DAMPING = 0.5


@dataclass(frozen=True, eq=False)
class Segment:
    """One motion: knots of a trajectory and the gains that it is followed with."""

    name: str
    """Name of the experiment."""
    times: np.ndarray
    """(n,) s from its start."""
    positions: np.ndarray
    """(n, 7) rad."""
    velocities: np.ndarray
    """(n, 7) rad/s."""
    gains: np.ndarray
    """(2, 7), rows stiffness Nm/rad, damping ratio."""

    @property
    def duration(self) -> float:
        """s from start to rest."""
        return float(self.times[-1])

    @cached_property
    def trajectory(self) -> Trajectory:
        """What the controller follows. Raises Refusal for a segment that the controller would refuse."""
        return make_trajectory(self.times, self.positions, self.velocities, LIMITS)


@dataclass(frozen=True, eq=False)
class _Experiment:
    """A motion about a posture."""

    posture: np.ndarray
    """(7,) rad."""
    duration: float
    """s."""
    motion: Motion
    """Offsets from the posture and their velocities."""
    rate: float = 50.0
    """Knots per second."""
    damping_ratio: float = 1.0
    """Damping ratio of all joints."""

    def segment(self, name: str) -> Segment:
        # Knots lie on the motion's own corners, multiples of the rate, where there are any.
        times = np.linspace(0.0, self.duration, int(np.ceil(self.duration * self.rate - 1e-6)) + 1)
        offset, velocity = self.motion(times)
        return Segment(name, times, self.posture + offset, velocity, _gains(self.damping_ratio))


def _gains(damping_ratio: float) -> np.ndarray:
    return np.stack([STIFFNESS_MAX, np.full(7, damping_ratio)])


def _only(joint: int, value: float) -> np.ndarray:
    return np.where(np.arange(7) == joint, value, 0.0)


def _multisine(duration: float, amplitude: float, seed: int) -> Motion:
    rng = np.random.default_rng(seed)
    frequency = rng.permuted(np.linspace([0.12, 0.33, 0.7], [0.3, 0.6, 1.1], 7), axis=0).T
    share = np.array([[1.0], [0.5], [0.2]])
    return waves(duration, amplitude * share * SCALE, frequency, rng.uniform(0, 2 * np.pi, (3, 7)))


def _sinusoid(joint: int) -> _Experiment:
    amplitude = _only(joint, 0.4 * SCALE[joint])[None]
    return _Experiment(READY, 4.5, waves(4.5, amplitude, np.full((1, 7), 0.5), np.zeros((1, 7))))


def _triangle(stroke: float, speed: float, turn: float, cycles: int) -> _Experiment:
    # Neighbours in opposite directions: the hand stays about where it is.
    return _Experiment(READY, *triangle(stroke, speed * SCALE * np.array([1, -1] * 3 + [1]), turn, cycles))


def _dwell(posture: np.ndarray, rest: float) -> _Experiment:
    side = np.array([1, -1, 1, 1, -1, 1, -1]) * SCALE
    stops = [level * side for level in (0.2, 0.1, -0.1, 0.0, 0.1)]
    return _Experiment(posture, *visits(stops, 0.5, rest))


def _microstrokes() -> _Experiment:
    # Loops inside loops: 50 mrad, with reversals of 20, 6 and 2 mrad on the way.
    path = np.array([0, 50, 30, 50, 44, 50, 48, 50, 0, 20, 14, 20, 18, 20, 0, -10, -4, -10, -8, -10]) / 1e3
    return _Experiment(READY, *visits([level * np.ones(7) for level in path[1:]], 0.35, 0.05), rate=100.0)


def _chirp(joints: Sequence[int], duration: float = 10.0) -> _Experiment:
    # So fast that torque stays within half its greatest rate of change at the highest frequency.
    speed = np.isin(np.arange(7), joints) * np.array([0.15, 0.2, 0.12, 0.25, 0.4, 0.4, 0.4])
    return _Experiment(READY, duration, chirp(duration, speed, (0.3, 8.0), 0.15), rate=100.0)


_SUITE: dict[str, Callable[[], _Experiment]] = {
    "reference": lambda: _Experiment(READY, 8.0, _multisine(8.0, 0.24, 1)),
    **{f"sinusoid_{name[-1]}": lambda j=j: _sinusoid(j) for j, name in enumerate(NOMINAL.joints)},
    "triangle_slow": lambda: _triangle(2.4, 0.02, 0.1, 2),
    "triangle_medium": lambda: _triangle(2.0, 0.1, 0.2, 2),
    "triangle_fast": lambda: _triangle(1.0, 0.45, 0.4, 4),
    "microstrokes": _microstrokes,
    "dwell": lambda: _dwell(READY, 1.0),
    "chirp_odd": lambda: _chirp([0, 2, 4, 6]),
    "chirp_even": lambda: _chirp([1, 3, 5]),
    "second_posture": lambda: _Experiment(SECOND, 9.0, _multisine(9.0, 0.22, 2)),
    "second_dwell": lambda: _dwell(SECOND, 0.8),
    "third_posture": lambda: _Experiment(THIRD, 9.0, _multisine(9.0, 0.22, 3)),
    "third_dwell": lambda: _dwell(THIRD, 0.8),
    "low_damping": lambda: _Experiment(READY, 8.0, _multisine(8.0, 0.24, 4), damping_ratio=LOW_DAMPING),
    "reference_again": lambda: _Experiment(READY, 8.0, _multisine(8.0, 0.24, 1)),
}
NAMES = tuple(_SUITE)


def _sweep(joint: int) -> _Experiment:
    # Two sinusoids that beat: one joint's speed swells from nothing to 0.7 rad/s and back, stroke after
    # stroke.
    amplitude = np.stack([_only(joint, 0.13 * SCALE[joint])] * 2)
    frequency = np.array([[0.425], [0.475]]) * np.ones((1, 7))
    return _Experiment(READY, 20.0, waves(20.0, amplitude, frequency, np.array([[np.pi / 2], [-np.pi / 2]])))


def _nudge(joint: int) -> _Experiment:
    # The first motion of a new set-up: 5 degrees and back, at 3 degrees a second.
    return _Experiment(READY, *visits([_only(joint, np.radians(5.0))], 3.0, 1.0))


# Not part of the suite: each but the nudges tests one question for longer, where the suite left it open (sim2real.excitation.power).
_FURTHER: dict[str, Callable[[], _Experiment]] = {
    "long_reference": lambda: _Experiment(READY, 20.0, _multisine(20.0, 0.24, 5)),
    "long_second": lambda: _Experiment(SECOND, 20.0, _multisine(20.0, 0.22, 6)),
    "long_third": lambda: _Experiment(THIRD, 20.0, _multisine(20.0, 0.22, 7)),
    "long_slow": lambda: _triangle(5.0, 0.02, 0.1, 3),
    "long_chirp_odd": lambda: _chirp([0, 2, 4, 6], 30.0),
    "long_chirp_even": lambda: _chirp([1, 3, 5], 30.0),
    **{f"sweep_{name[-1]}": lambda j=j: _sweep(j) for j, name in enumerate(NOMINAL.joints)},
    **{f"nudge_{name[-1]}": lambda j=j: _nudge(j) for j, name in enumerate(NOMINAL.joints)},
}
FURTHER = tuple(_FURTHER)
_ALL = _SUITE | _FURTHER


def make_experiment(name: str) -> Segment:
    """The segment of one experiment, by its own name. Raises KeyError for one that is not known."""
    return _ALL[name]().segment(name)


def make_suite(only: Sequence[str] = (), start: np.ndarray = READY) -> list[Segment]:
    """The plan of the named experiments (the suite, `NAMES`, if none is named) for an arm that rests at
    `start`
    (7,) rad.

    Beside those of the suite there are `FURTHER` ones. A name may be that of a family: "sinusoid" stands for
    all
    seven. Transfers lie between experiments about
    different postures. Raises ValueError for a name that is not known.
    """
    chosen: list[str] = []
    for wanted in only or NAMES:
        found = [name for name in _ALL if name == wanted or name.rsplit("_", 1)[0] == wanted]
        if not found:
            raise ValueError(f"experiment {wanted!r}: expected one of {', '.join(_ALL)}")
        chosen += [name for name in found if name not in chosen]
    plan: list[Segment] = []
    position = np.asarray(start, dtype=float)
    for name in sorted(chosen, key=tuple(_ALL).index):
        segment = make_experiment(name)
        if not np.allclose(position, segment.positions[0], rtol=0.0, atol=1e-6):
            plan.append(make_transfer(position, segment.positions[0]))
        plan.append(segment)
        position = segment.positions[-1]
    return plan


def make_transfer(start: np.ndarray, end: np.ndarray) -> Segment:
    """A straight move in joint space, rest to rest, between two positions (7,) rad."""
    duration = max(SHORTEST_TRANSFER, 1.875 * float(np.abs(end - start).max()) / TRANSFER_SPEED)
    times = np.linspace(0.0, duration, int(np.ceil(duration * 25)) + 1)
    share, rate = least_jerk(times / duration)
    return Segment(
        "transfer", times, start + share[:, None] * (end - start), rate[:, None] / duration * (end - start), _gains(1.0)
    )


def schedule_starts(plan: Sequence[Segment], begin: int = 0) -> list[int]:
    """Stamps, ns, of the policy ticks at which the segments start, the first at or after `begin` + PAUSE."""
    starts, free = [], begin
    for segment in plan:
        start = -(-(free + round(PAUSE * 1e9)) // TICK_NS) * TICK_NS
        starts.append(start)
        free = start + round(segment.duration * 1e9)
    return starts


def end_stamp(plan: Sequence[Segment], begin: int = 0) -> int:
    """Stamp, ns, of the policy tick at which the arm rests after the plan."""
    last = schedule_starts(plan, begin)[-1] + round(plan[-1].duration * 1e9)
    return -(-(last + round(PAUSE * 1e9)) // TICK_NS) * TICK_NS
