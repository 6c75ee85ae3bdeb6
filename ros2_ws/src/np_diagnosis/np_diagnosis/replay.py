"""Closed-loop replay: what a simulated arm does under the recorded targets and gains.

The impedance law of np_control runs in the loop, on the simulated state; what the controller added to its law
(Coriolis torque, feed-forward of a trajectory) is replayed as it was commanded. Many windows and many parameter
sets are stepped at once, each simulation with its own model fields (mujoco.batch).
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from mujoco.batch import Batch

from np_control.impedance import torque as impedance_torque

from np_diagnosis.plant import Plant
from np_diagnosis.signals import Log

GAP = 1.5  # periods between two rows after which a recording is cut
SHORTEST = 1.0  # s
EVERY = 0.01  # s between the samples that are compared

FIELDS = {"frictionloss": "dof_frictionloss", "damping": "dof_damping", "armature": "dof_armature"}
INERTIA = ("mass", "com")
MEASURED, COMMANDED = ("position", "velocity"), ("target", "stiffness", "damping_ratio", "feedforward")
W = mujoco.mjtWarning
BAD = [int(warning) for warning in (W.mjWARN_BADQPOS, W.mjWARN_BADQVEL, W.mjWARN_BADQACC)]
COUNT = 1  # of a warning's two numbers, the one that counts it

Values = Mapping[str, np.ndarray]
"""Parameters of S simulations of k joints: frictionloss (S, k) Nm, damping (S, k) Nms/rad, armature (S, k) kg m^2,
gain (S, k) of the drives, mass (S, k) kg and com (S, k, 3) m of the links. What is left out stays nominal."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A recorded stretch without gap, one row a control period: all (n, k), k joints.

    position rad and velocity rad/s: measured; target rad, stiffness Nm/rad, damping_ratio: of the impedance law;
    feedforward Nm: the rest of the commanded torque.
    """

    name: str
    period: float
    position: np.ndarray
    velocity: np.ndarray
    target: np.ndarray
    stiffness: np.ndarray
    damping_ratio: np.ndarray
    feedforward: np.ndarray

    def __len__(self) -> int:
        return len(self.position)

    @property
    def activity(self) -> np.ndarray:
        """Standard deviation (k,) rad of each joint's target."""
        return self.target.std(axis=0)

    def cut(self, rows: slice | np.ndarray) -> Motion:
        """Some rows of it."""
        return replace(self, **{name: getattr(self, name)[rows] for name in MEASURED + COMMANDED})

    def resampled(self, period: float) -> Motion:
        """At another period: what was measured is interpolated, what was commanded held."""
        rows = np.arange(0.0, (len(self) - 1) * self.period, period) / self.period
        held = self.cut(np.floor(rows + 1e-9).astype(int))
        below, share = np.floor(rows + 1e-9).astype(int), (rows % 1.0)[:, None]
        between = {n: (1 - share) * getattr(self, n)[below] + share * getattr(self, n)[below + 1] for n in MEASURED}
        return replace(held, period=period, **between)

    def windows(self, seconds: float) -> list[Motion]:
        """Whole windows of this length, one after the other; a remainder is dropped."""
        rows = round(seconds / self.period)
        return [self.cut(slice(i, i + rows)) for i in range(0, len(self) - rows + 1, rows)]


def motions(log: Log, stiffness: np.ndarray, damping_ratio: np.ndarray) -> list[Motion]:
    """The stretches of a log without gap, given the gains (m, k) or (k,) of its commands' rows.

    Raises ValueError where no command was recorded, or no stretch is long enough.
    """
    commands = log.commands
    if commands is None:
        raise ValueError(f"{log.name}: a replay needs the commands; expected effort_command, found none")
    time = log.time[commands.rows]
    position, velocity = log.position[commands.rows], log.velocity[commands.rows]
    stiffness, damping_ratio = (np.broadcast_to(gain, position.shape) for gain in (stiffness, damping_ratio))
    law = impedance_torque(position, velocity, commands.target, stiffness, damping_ratio, 0.0)
    period = float(np.median(np.diff(time)))
    whole = Motion(
        log.name, period, position, velocity, commands.target, stiffness, damping_ratio, commands.torque - law
    )
    edges = [0, *(np.flatnonzero(np.diff(time) > GAP * period) + 1), len(time)]
    parts = [whole.cut(slice(a, b)) for a, b in zip(edges[:-1], edges[1:]) if (b - a) * period >= SHORTEST]
    if not parts:
        raise ValueError(f"{log.name}: expected {SHORTEST} s of commands without gap, found none")
    return parts


class Replay:
    """Simulates an arm along motions, which must have one control period and the arm's joints.

    threads: 0 for all cores. Raises ValueError for motions of another arm or period.
    """

    def __init__(self, plant: Plant, recorded: list[Motion], threads: int = 0):
        self.plant, self.motions, self._threads = plant, recorded, threads
        periods, joints = {m.period for m in recorded}, {m.position.shape[1] for m in recorded}
        if joints != {plant.model.nv}:
            raise ValueError(f"replay: expected motions of {plant.model.nv} joints, got {sorted(joints)}")
        period = max(periods)
        if period - min(periods) > 1e-4 * period:
            raise ValueError(f"replay: expected motions of one period, got {sorted(periods)} s")
        self._substeps = max(1, round(period / plant.model.opt.timestep))
        if abs(self._substeps * plant.model.opt.timestep - period) > 1e-3 * period:
            raise ValueError(
                f"replay: expected a period that is a multiple of {plant.model.opt.timestep} s, got {period} s"
            )
        self._every = max(1, round(EVERY / period))
        self._length = max(len(m) for m in recorded)
        names = ("position", *COMMANDED)
        # Time first: a step reads one row of each. Shorter motions stand still at their end, unseen.
        self._rows = {name: np.stack([self._padded(getattr(m, name)) for m in recorded], axis=1) for name in names}
        self._start = np.stack([np.stack([m.position[0], m.velocity[0]]) for m in recorded])
        self.steps = 0  # physics steps so far
        self._cached = _Simulations(plant, len(recorded), False, threads)

    def errors(self, which: np.ndarray, values: Values) -> np.ndarray:
        """Simulated minus measured position (S, m, k) rad, every 10 ms, of motions `which` (S,) with `values`.

        NaN after the end of a motion, and for a simulation that diverged.
        """
        which = np.asarray(which)
        simulations = self._simulations(len(which), any(name in values for name in INERTIA))
        simulations.begin(self._start[which], values)
        ends = np.array([len(self.motions[i]) for i in which])
        rows = [array[: ends.max(), which] for array in self._rows.values()]
        errors = []
        for t, (position, *law) in enumerate(zip(*rows)):
            if t and t % self._every == 0:
                errors.append(np.where((t < ends)[:, None], simulations.position - position, np.nan))
            simulations.step(*law, self._substeps)
        self.steps += len(which) * ends.max() * self._substeps
        errors = np.stack(errors, axis=1)
        errors[simulations.diverged] = np.nan
        return errors

    def _simulations(self, count: int, is_inertia_free: bool) -> _Simulations:
        # One set is kept, which serves the calls of one fit and does not fill the memory.
        if (self._cached.count, self._cached.is_inertia_free) != (count, is_inertia_free):
            self._cached = _Simulations(self.plant, count, is_inertia_free, self._threads)
        return self._cached

    def _padded(self, values: np.ndarray) -> np.ndarray:
        return np.concatenate([values, np.repeat(values[-1:], self._length - len(values), axis=0)])


class _Simulations:
    """`count` copies of an arm, each with parameters of its own, stepped together."""

    def __init__(self, plant: Plant, count: int, is_inertia_free: bool, threads: int):
        self.count, self.is_inertia_free = count, is_inertia_free
        self._plant, self._nominal = plant, None
        model = copy.copy(plant.model)
        if is_inertia_free:
            # The robot compensates the gravity of the nominal arm, wherever the simulated one is.
            model.body_gravcomp[:] = 0.0
            self._nominal = Batch(plant.model, count, threads)
            self._compensation = self._nominal.bind("qfrc_gravcomp")
        self._batch = Batch(model, count, threads)
        self.position = self._batch.bind("qpos")
        self._velocity, self._applied = self._batch.bind("qvel"), self._batch.bind("qfrc_applied")

    def begin(self, start: np.ndarray, values: Values) -> None:
        """Put the simulations at start (S, 2, k), position and velocity, with the parameters given."""
        values = {**self._plant.nominal(), **values}
        batch, links = self._batch, self._plant.links
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        batch.warning[:] = 0
        for name, field in FIELDS.items():
            batch.expand(field)[:] = values[name]
        self._gain = values["gain"]
        if self.is_inertia_free:
            batch.expand("body_mass")[:, links] = values["mass"]
            batch.expand("body_ipos")[:, links] = values["com"]
        batch.set_const()
        self.position[:], self._velocity[:] = start[:, 0], start[:, 1]

    def step(self, target, stiffness, damping_ratio, feedforward, substeps: int) -> None:
        """One control period under the impedance law, all (S, k)."""
        wanted = impedance_torque(self.position, self._velocity, target, stiffness, damping_ratio, feedforward)
        limit = self._plant.torque_limit
        self._applied[:] = self._gain * np.clip(wanted, -limit, limit)
        if self._nominal is not None:
            self._nominal.bind("qpos")[:] = self.position
            self._nominal.forward(stage=mujoco.mjtStage.mjSTAGE_VEL)
            self._applied += self._compensation
        self._batch.step(nstep=substeps)

    @property
    def diverged(self) -> np.ndarray:
        """Simulations (S,) that MuJoCo had to reset."""
        return self._batch.warning[:, BAD, COUNT].any(axis=1)
