"""Closed-loop replay: what a simulated arm does under the recorded targets and gains.

The impedance law of np_control runs in the loop, on the simulated state, as a drive of the MuJoCo model; what
the controller added to its law (Coriolis torque, feed-forward of a trajectory) is replayed as it was
commanded. Many stretches and parameter sets are stepped at once, each simulation with its own model fields
(mujoco.batch).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from mujoco.batch import Batch
from sim2real.recordings.signals import Log

from np_blind.baselines.plant import ArmPlant
from np_control.impedance import damping
from np_control.impedance import torque as impedance_torque

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
"""Parameters of S simulations of k joints: frictionloss (S, k) Nm, damping (S, k) Nms/rad, armature (S, k) kg
m^2, gain (S, k) of the drives, mass (S, k) kg and com (S, k, 3) m of the links. What is left out stays
nominal."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """A recorded stretch without gap, one row a control period: all (n, k), k joints.

    position rad and velocity rad/s: measured; target rad, stiffness Nm/rad, damping_ratio: of the impedance
    law; feedforward Nm: the rest of the commanded torque.
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
    def duration(self) -> float:
        """s from the first to the last row."""
        return (len(self) - 1) * self.period

    @property
    def activity(self) -> np.ndarray:
        """Standard deviation (k,) rad of each joint's target."""
        return self.target.std(axis=0)

    def cut(self, rows: slice | np.ndarray) -> Stretch:
        """Some rows of it."""
        return replace(self, **{name: getattr(self, name)[rows] for name in MEASURED + COMMANDED})

    def resampled(self, period: float) -> Stretch:
        """At another period: what was measured is interpolated, what was commanded held."""
        rows = np.arange(0.0, (len(self) - 1) * self.period, period) / self.period
        held = self.cut(np.floor(rows + 1e-9).astype(int))
        below, share = np.floor(rows + 1e-9).astype(int), (rows % 1.0)[:, None]
        between = {n: (1 - share) * getattr(self, n)[below] + share * getattr(self, n)[below + 1] for n in MEASURED}
        return replace(held, period=period, **between)

    def delayed(self, seconds: float) -> Stretch:
        """As if commands had taken effect later than at their rows; the first ones are held until then."""
        rows = np.maximum(np.arange(len(self)) - round(seconds / self.period), 0)
        return replace(self, **{name: getattr(self, name)[rows] for name in COMMANDED})

    def windows(self, seconds: float, stride: float) -> list[Stretch]:
        """Windows of this length, one begun every `stride` s; a remainder is dropped."""
        rows, step = round(seconds / self.period), max(1, round(stride / self.period))
        return [self.cut(slice(i, i + rows)) for i in range(0, len(self) - rows + 1, step)]


def stretch(
    name: str,
    period: float,
    position: np.ndarray,
    velocity: np.ndarray,
    target: np.ndarray,
    torque: np.ndarray,
    stiffness: np.ndarray,
    damping_ratio: np.ndarray,
) -> Stretch:
    """A stretch, given the torque (n, k) Nm that was commanded and gains (n, k) or (k,)."""
    stiffness, damping_ratio = (np.broadcast_to(gain, position.shape) for gain in (stiffness, damping_ratio))
    law = impedance_torque(position, velocity, target, stiffness, damping_ratio, 0.0)
    return Stretch(name, period, position, velocity, target, stiffness, damping_ratio, torque - law)


def stretches(log: Log) -> list[Stretch]:
    """The stretches of a log without gap.

    Raises ValueError where no command was recorded, or no stretch is long enough.
    """
    commands = log.commands
    if commands is None:
        raise ValueError(f"{log.name}: a replay needs the commands; expected effort_command, found none")
    time, stiffness = log.time[commands.rows], commands.stiffness
    whole = stretch(
        log.name,
        float(np.median(np.diff(time))),
        log.position[commands.rows],
        log.velocity[commands.rows],
        commands.target,
        commands.torque,
        stiffness,
        commands.damping / np.sqrt(stiffness),
    )
    edges = [0, *(np.flatnonzero(np.diff(time) > GAP * whole.period) + 1), len(time)]
    parts = [whole.cut(slice(a, b)) for a, b in zip(edges[:-1], edges[1:]) if (b - a) * whole.period >= SHORTEST]
    if not parts:
        raise ValueError(f"{log.name}: expected {SHORTEST} s of commands without gap, found none")
    return parts


class Replay:
    """Simulates an arm along recorded stretches, whose period must be the plant's timestep.

    threads: 0 for all cores. Raises ValueError for stretches of another arm or period.
    """

    def __init__(self, plant: ArmPlant, recorded: list[Stretch], threads: int = 0):
        self.plant, self._threads = plant, threads
        step, count = plant.model.opt.timestep, plant.model.nv
        for stretch_ in recorded:
            if stretch_.position.shape[1] != count or abs(stretch_.period - step) > 1e-3 * step:
                raise ValueError(
                    f"replay: {stretch_.name}: expected {count} joints every {step} s, got "
                    f"{stretch_.position.shape[1]} every {stretch_.period:.6g} s"
                )
        self._every = max(1, round(EVERY / step))
        length = max(len(s) for s in recorded)
        self._measured, self._stiffness, self._damping, self._command = (
            # Shorter stretches stand still at their end, unseen.
            np.stack([np.concatenate([v, np.repeat(v[-1:], length - len(v), axis=0)]) for v in values])
            for values in zip(*(_drive(s) for s in recorded))
        )
        self._ends = np.array([len(s) for s in recorded])
        self._start = np.stack([np.stack([s.position[0], s.velocity[0]]) for s in recorded])
        self._batch, self._is_free = Batch(plant.model, len(recorded), threads), False
        self.steps = 0  # physics steps so far

    def errors(self, which: np.ndarray, values: Values) -> np.ndarray:
        """Simulated minus measured position (S, m, k) rad, every 10 ms, of stretches `which` (S,) with
        `values`.

        NaN after the end of a stretch, and for a simulation that diverged.
        """
        which = np.asarray(which)
        values = {**self.plant.nominal(), **values}
        batch = self._prepare(which, values)
        length = self._ends[which].max()
        simulated = np.empty((len(which), length, self.plant.model.nv))
        simulated[:, 0] = self._start[which, 0]
        stiffness, damping = self._stiffness[:, :length][which], self._damping[:, :length][which]
        # The last row is only compared: no step is taken with its gains.
        changes = (np.diff(stiffness[:, :-1], axis=1) != 0) | (np.diff(damping[:, :-1], axis=1) != 0)
        edges = [0, *(np.flatnonzero(changes.any(axis=(0, 2))) + 1), length - 1]
        law, gain = (
            batch.expand("actuator_biasprm"),
            np.broadcast_to(values["gain"], self._start[which, 0].shape),
        )
        for begin, end in zip(edges[:-1], edges[1:]):
            # The gear scales the drive's torque, and the position and velocity that it measures.
            law[:, :, 1], law[:, :, 2] = -stiffness[:, begin] / gain, -damping[:, begin] / gain
            done = batch.rollout(end - begin, self._command[which, begin:end], record=("qpos",))
            simulated[:, begin + 1 : end + 1] = done["qpos"]
        self.steps += len(which) * int(length - 1)
        kept = np.arange(self._every, length, self._every)
        errors = simulated[:, kept] - self._measured[which][:, kept]
        errors[kept[None] >= self._ends[which][:, None]] = np.nan
        errors[batch.warning[:, BAD, COUNT].any(axis=1)] = np.nan
        return errors

    def _prepare(self, which: np.ndarray, values: Values) -> Batch:
        """Simulations at the start of their stretches, with their parameters."""
        nominal = self.plant.nominal()
        is_free = any(
            values[name].shape != nominal[name].shape or (values[name] != nominal[name]).any() for name in INERTIA
        )
        if (self._batch.nsim, self._is_free) != (len(which), is_free):
            model = self.plant.free_model if is_free else self.plant.model
            self._batch, self._is_free = Batch(model, len(which), self._threads), is_free
        batch = self._batch
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        batch.warning[:] = 0
        for name, field in FIELDS.items():
            batch.expand(field)[:] = values[name]
        batch.expand("actuator_gear")[:, :, 0] = values["gain"]
        if is_free:
            links = batch.model.jnt_bodyid
            batch.expand("body_mass")[:, links] = values["mass"]
            batch.expand("body_ipos")[:, links] = values["com"]
        batch.set_const()
        batch.qpos, batch.qvel = self._start[which, 0], self._start[which, 1]
        return batch


def _drive(recorded: Stretch) -> tuple[np.ndarray, ...]:
    """Measured position, stiffness, damping, and the law's command at rest at zero, all (n, k)."""
    zero = np.zeros_like(recorded.position)
    stiffness, ratio = recorded.stiffness, recorded.damping_ratio
    command = impedance_torque(zero, zero, recorded.target, stiffness, ratio, recorded.feedforward)
    return recorded.position, np.asarray(stiffness), damping(stiffness, ratio), command
