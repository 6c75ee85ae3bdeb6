"""What a recording shows, as far as effects may look at it. The doctor fills it; effects only read it.

The arm's model, its dynamics and the samples are the doctor's: here stands what effects use of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Protocol

import numpy as np


class ArmProperties(Protocol):
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


class RecordedLog(Protocol):
    """A recording: duration s."""

    @property
    def duration(self) -> float: ...


class RecordedSamples(Protocol):
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

    def filter_function(self, joint: int, function: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        """function(position (m,), velocity (m,)) of a joint on the fine grid, through the filter: (n,)."""

    def filter(self, parts: list[np.ndarray]) -> np.ndarray:
        """Values (m,) on the fine grid of each stretch, through the filter: (n,)."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Nominal torques of samples, all (n, k) Nm.

    gravity: holds the arm; inertial: accelerates it, Coriolis included, rotors not; rotors; friction. `total`
    is what the sensor should have shown (with gravity only if the sensor does); load: through the gear;
    direction (n, k): that of motion, -1..1. motion: of the links, as the doctor
    has it; gravity_slope (n, k, k): change of joint i's
    gravity torque with position j; inertia (n, k, k): torque of joint i that turns link j about its own centre;
    link_errors (n, c) of each joint: one standard deviation of what any arm's links are off by, component by component.
    """

    gravity: np.ndarray
    inertial: np.ndarray
    rotors: np.ndarray
    friction: np.ndarray
    total: np.ndarray
    load: np.ndarray
    direction: np.ndarray
    motion: object
    gravity_slope: np.ndarray
    inertia: np.ndarray
    link_errors: tuple[np.ndarray, ...]


class RigidBody(Protocol):
    """Rigid-body dynamics of the nominal arm at the samples."""

    def regressor(self, link: int) -> np.ndarray:
        """Change (n, k, 10) of the torques with mass, moments (3) and inertia (6) of one link."""

    def mass_centre_change(self, link: int) -> np.ndarray:
        """Change (n, k, 3) of the torques with a link's m c along x, y, z; its inertia about its centre stays."""

    def gravity_torque(self, gravity: np.ndarray) -> np.ndarray:
        """Torque (n, k) Nm that holds the arm under another gravity (3,) m/s^2."""

    def link_inertia_traces(self) -> np.ndarray:
        """Inertia (k,) kg m^2 of each link about its own centre, as a number."""

    def links_moved_by(self, joint: int) -> list[int]:
        """Links that a joint turns."""


@dataclass(frozen=True, eq=False)
class Drive:
    """Commands and their answers, one row a period: n rows, k joints.

    time (n,) s, trajectory (n,); period s; starts: rows at which a stretch without a gap begins. law,
    commanded, measured (n, k) Nm without gravity: the law replayed, what was asked for, what came; error
    (n, k) rad: joint target with its lead, minus position; velocity, target_velocity (n, k) rad/s; stiffness
    (n, k) Nm/rad, damping (n, k) Nms/rad: the gains in force; gravity (n, k) Nm; guarded (n, k) bool: commands
    that the controller's guards cut, which the law does not tell. late s: what the loop is late by before any effect;
    arrived (n, k) Nm: the commands so much later, which is what a drive has to work with. is_replayed: whether law, error and
    gains are known; of another arm's controller they may not be.
    """

    time: np.ndarray
    trajectory: np.ndarray
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
    guarded: np.ndarray
    late: float
    arrived: np.ndarray
    is_replayed: bool = True

    def only(self, rows: np.ndarray) -> Drive:
        """These rows (n,) bool alone, which are whole stretches."""
        if rows.all():
            return self
        own = {f.name: getattr(self, f.name) for f in fields(self)}
        kept = {name: x[rows] for name, x in own.items() if isinstance(x, np.ndarray) and name != "starts"}
        begins = np.zeros(len(rows), bool)
        begins[self.starts] = True
        return replace(self, **kept, starts=np.flatnonzero(begins[rows]))


@dataclass(frozen=True, eq=False)
class Transmission:
    """Motor side: time (n,), trajectory (n,), twist (n, k) rad = motor - joint, load (n, k) Nm through the
    gear with gravity, load_rate (n, k) Nm/s. wound: the twist of each stretch (m, k) on the samples' fine
    grid, without the noise of its two encoders: what the load winds up in proportion, and of the rest what is
    no noise."""

    time: np.ndarray
    trajectory: np.ndarray
    twist: np.ndarray
    load: np.ndarray
    load_rate: np.ndarray
    wound: tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class Context:
    """What effects may look at.

    drive: None without commands. transmission: None without motor angles. ripples: orders per revolution found, by joint.
    quanta (k,) rad: step of each encoder, 0 where none shows. held (n,) bool: periods of the drive in which the last command
    was held, None without drive; held_share: their share, held_error: its standard error, since losses come by chance.
    With a reference, quanta are 0 where they are as they were, and held_share is by how much more are lost now, with the
    periods now lost in held where that is sure, and none where it is not; set_aside (n,) bool: lost periods of which
    nothing is asked, since the arm had such before.
    logs: the recordings, one after the other; reference: of how many of them, the first ones, the arm is what the others
    are compared with. 0: with the nominal arm. constant (n, k) Nm: what a share of error of a motor's torque constant is a
    share of, where torque is a current times a constant that the recording itself had to tell; None where it was measured.
    """

    arm: ArmProperties
    logs: Sequence[RecordedLog]
    samples: RecordedSamples
    prediction: Prediction
    rigid: RigidBody
    drive: Drive | None
    transmission: Transmission | None
    ripples: Mapping[int, tuple[int, ...]]
    held: np.ndarray | None
    held_share: float
    quanta: np.ndarray
    held_error: float = 0.0
    set_aside: np.ndarray | None = None
    reference: int = 0
    constant: np.ndarray | None = None

    def is_later(self, trajectory: np.ndarray) -> np.ndarray:
        """Whether rows (n,) of these recordings, by number, are of the recordings in which effects may show: all, or those after the reference."""
        return trajectory >= self.reference

    @property
    def begins(self) -> np.ndarray:
        """When each recording (m,) began, s, as if one was made after the other; those to be compared with a reference are
        of another day, on which the arm began anew."""
        ends = np.concatenate([[0.0], np.cumsum([log.duration for log in self.logs])])
        return np.concatenate([ends[: self.reference], ends[self.reference : -1] - ends[self.reference]])
