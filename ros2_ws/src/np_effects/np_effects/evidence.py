"""What a recording shows, as far as effects may look at it. The doctor fills it; effects only read it.

The arm's model, the samples and what is predicted of them are the doctor's: here stands what effects use of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np


class Arm(Protocol):
    """The nominal arm, k joints base to tip; SI units. rest (k,): posture in which a cable pulls with its offset only; tip
    (3,) m: tool point in the last link."""

    joints: tuple[str, ...]
    rest: np.ndarray
    tip: np.ndarray
    gravity: np.ndarray
    torque_limit: np.ndarray
    frictionloss: np.ndarray
    damping: np.ndarray
    armature: np.ndarray

    def __len__(self) -> int: ...


class Log(Protocol):
    """A recording: duration s."""

    @property
    def duration(self) -> float: ...


class Samples(Protocol):
    """Filtered motion: time (n,) s within its trajectory (n,), position, velocity, acceleration (n, k), torque_rate (n, k)
    Nm/s; with_gravity: whether the torque holds the arm's weight as well."""

    time: np.ndarray
    trajectory: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque_rate: np.ndarray
    with_gravity: bool
    grids: Sequence[tuple[int, np.ndarray]]

    def __len__(self) -> int: ...

    def filtered(self, joint: int, function: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        """function(position (m,), velocity (m,)) of a joint on the fine grid, through the filter: (n,)."""

    def filter(self, parts: list[np.ndarray]) -> np.ndarray:
        """Values (m,) on the fine grid of each stretch, through the filter: (n,)."""


class Prediction(Protocol):
    """Nominal torques (n, k) Nm of the samples; direction (n, k) of motion, -1..1; gravity_slope (n, k, k) Nm/rad; inertia
    (n, k, k): torque of joint i that turns link j about its own centre."""

    gravity: np.ndarray
    friction: np.ndarray
    load: np.ndarray
    direction: np.ndarray
    gravity_slope: np.ndarray
    inertia: np.ndarray


class RigidBody(Protocol):
    """Rigid-body dynamics of the nominal arm at the samples."""

    def regressor(self, link: int) -> np.ndarray:
        """Change (n, k, 10) of the torques with mass, moments (3) and inertia (6) of one link."""

    def gravity_torque(self, gravity: np.ndarray) -> np.ndarray:
        """Torque (n, k) Nm that holds the arm under another gravity (3,) m/s^2."""

    def own_sizes(self) -> np.ndarray:
        """Inertia (k,) kg m^2 of each link about its own centre, as a number."""

    def carried(self, joint: int) -> list[int]:
        """Links that a joint turns."""


class Drive(Protocol):
    """Commands and their answers, one row a period: time (n,) s; law, commanded, measured, gravity (n, k) Nm; error (n, k)
    rad: target with its lead minus position; velocity, target_velocity (n, k) rad/s; stiffness (n, k) Nm/rad, damping (n, k)
    Nms/rad: gains in force. starts: rows at which a stretch without a gap begins; period s."""

    time: np.ndarray
    period: float
    starts: np.ndarray
    law: np.ndarray
    commanded: np.ndarray
    measured: np.ndarray
    error: np.ndarray
    velocity: np.ndarray
    target_velocity: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    gravity: np.ndarray


class Transmission(Protocol):
    """The motor side: load (n, k) Nm through the gear, load_rate (n, k) Nm/s, wound: twist (m, k) rad of each stretch on the
    samples' fine grid, without the noise of its two encoders."""

    load: np.ndarray
    load_rate: np.ndarray
    wound: tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class Context:
    """What effects may look at.

    drive: None without commands. transmission: None without motor angles. ripples: orders per revolution found, by joint.
    quanta (k,) rad: step of each encoder, 0 where none shows. held (n,) bool: periods of the drive in which the last command
    was held, None without drive; held_share: their share of the `held_seen` periods in which that could have been seen.
    logs: the recordings, one after the other.
    """

    arm: Arm
    logs: Sequence[Log]
    samples: Samples
    prediction: Prediction
    rigid: RigidBody
    drive: Drive | None
    transmission: Transmission | None
    ripples: Mapping[int, tuple[int, ...]]
    held: np.ndarray | None
    held_share: float
    quanta: np.ndarray
    held_seen: int = 0
