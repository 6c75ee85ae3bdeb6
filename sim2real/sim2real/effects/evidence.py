"""What a recording shows, as far as effects may look at it. The diagnosis fills it; effects only read it.

Arrays have n rows and k joints, base to tip.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # effects are loaded by simulators too, which have no use for the diagnosis
    from sim2real.arm.model import Arm
    from sim2real.arm.prediction import Prediction
    from sim2real.arm.sampled_dynamics import SampledDynamics
    from sim2real.recordings.signals import Log, Samples


@dataclass(frozen=True, eq=False)
class Drive:
    """Commands and the measured responses, one row a control period; torques (n, k) Nm without gravity."""

    time: np.ndarray
    """(n,) s within its trajectory."""
    trajectory: np.ndarray
    """(n,) number of the recording."""
    period: float
    """s, control period."""
    starts: np.ndarray
    """Rows at which a stretch without a gap begins."""
    law: np.ndarray
    """Torque of the controller's law, replayed."""
    commanded: np.ndarray
    """Torque that the controller commanded."""
    measured: np.ndarray
    """Torque that was measured in the next period."""
    error: np.ndarray
    """(n, k) rad, joint target with its lead, minus position."""
    velocity: np.ndarray
    """(n, k) rad/s."""
    target_velocity: np.ndarray
    """(n, k) rad/s."""
    stiffness: np.ndarray
    """(n, k) Nm/rad, gain in force."""
    damping: np.ndarray
    """(n, k) Nms/rad, gain in force."""
    gravity: np.ndarray
    """Torque that holds the arm."""
    guarded: np.ndarray
    """(n, k) bool: commands clipped by the controller's guards, which the law does not contain."""
    late: float
    """s, delay of the loop before any effect."""
    arrived: np.ndarray
    """Commanded torque after that delay: what a drive receives."""
    is_replayed: bool = True
    """Whether law, error and gains are known; of another arm's controller they may not be."""

    def only(self, rows: np.ndarray) -> Drive:
        """These rows (n,) bool alone, which are whole stretches."""
        if rows.all():
            return self
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        selected = {name: x[rows] for name, x in values.items() if isinstance(x, np.ndarray) and name != "starts"}
        begins = np.zeros(len(rows), bool)
        begins[self.starts] = True
        return replace(self, **selected, starts=np.flatnonzero(begins[rows]))


@dataclass(frozen=True, eq=False)
class Transmission:
    """The motor's side of the gear."""

    time: np.ndarray
    """(n,) s within its trajectory."""
    trajectory: np.ndarray
    """(n,) number of the recording."""
    twist: np.ndarray
    """(n, k) rad, motor minus joint angle."""
    load: np.ndarray
    """(n, k) Nm through the gear, with gravity."""
    load_rate: np.ndarray
    """(n, k) Nm/s."""
    wound: tuple[np.ndarray, ...]
    """Twist (m, k) of each stretch on the samples' fine grid without the noise of its two encoders: the part in proportion
    to the load, and the part of the rest that is no noise."""


@dataclass(frozen=True, eq=False)
class Context:
    """What effects may look at."""

    arm: Arm
    """The nominal arm."""
    logs: Sequence[Log]
    """The recordings, one after the other."""
    samples: Samples
    """Filtered samples of all recordings."""
    prediction: Prediction
    """Nominal torques of the samples."""
    rigid: SampledDynamics
    """Rigid-body dynamics at the samples."""
    drive: Drive | None
    """Commands and responses; None without commands."""
    transmission: Transmission | None
    """None without motor angles."""
    ripples: Mapping[int, tuple[int, ...]]
    """Orders of torque ripple per revolution that were found, by joint."""
    held: np.ndarray | None
    """(n,) bool: periods of the drive in which the last command stayed in force; None without drive. With a reference: the
    lost ones where surely more are lost than before."""
    held_share: float
    """Share of those periods; with a reference, by how much more are lost."""
    quanta: np.ndarray
    """(k,) rad, step of each encoder, 0 where none shows, or where it is as it was in the reference."""
    held_error: float = 0.0
    """Standard error of `held_share`, since losses come by chance."""
    set_aside: np.ndarray | None = None
    """(n,) bool: lost periods that are ignored, since the arm had such before."""
    reference: int = 0
    """Number of recordings, the first ones, with which the others are compared; 0: the nominal arm."""
    constant: np.ndarray | None = None
    """(n, k) Nm per relative error of a motor's torque constant, where the recording itself determined the constants; None
    where torque was measured."""
    laid_aside: tuple[tuple[int, float, float], ...] = ()
    """Windows (trajectory, begin s, end s) that neither a fit nor the choice of effects uses."""

    def window_of(self, trajectory: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Number (n,) of the window laid aside that each row lies in, by its recording and time s; -1 where in none."""
        found = np.full(len(time), -1)
        for number, (own, begin, end) in enumerate(self.laid_aside):
            found[(trajectory == own) & (time >= begin) & (time <= end)] = number
        return found

    @property
    def has_torque(self) -> np.ndarray:
        """(k,) bool: joints whose torque is known; not those whose motor current has an unknown constant."""
        constants = [log.per_ampere for log in self.logs if log.per_ampere is not None]
        return np.isfinite(constants).all(axis=0) if constants else np.ones(len(self.arm), bool)

    def is_later(self, trajectory: np.ndarray) -> np.ndarray:
        """Whether rows (n,) of these recordings, by number, are of the recordings in which effects may show: all, or those after the reference."""
        return trajectory >= self.reference

    @property
    def begins(self) -> np.ndarray:
        """When each recording (m,) began, s, as if one was made after the other; those to be compared with a reference are
        of another day, on which the arm began anew."""
        ends = np.concatenate([[0.0], np.cumsum([log.duration for log in self.logs])])
        return np.concatenate([ends[: self.reference], ends[self.reference : -1] - ends[self.reference]])
