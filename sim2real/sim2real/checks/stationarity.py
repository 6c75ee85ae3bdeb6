"""Does an effect have one size all the time, and is it all there is? Questions to what the chosen effects leave.

A fault that the catalogue lacks often resembles one that it has: a torque scale that fades, a rotor on a spring, a
stiffness that begins at some angle. The nearest effect of the catalogue then explains most of it, and what it leaves,
however small beside it, follows a pattern. A question is a set of columns, and its result is how well they predict
blocks outside their fit (as in `omnibus`):

- size: what each effect does, times time and its square, at every stage. An effect of the catalogue has one size.
  Where a thermal drift is in the model, this is tested on r1 only;
- place: the same times the joint's angle, its square, and the joint's speed;
- memory: the joint's acceleration up to a third of a second ago, on which the torque of rigid links does not depend
  (not tested on a joint with backlash, whose gear lets go of its link);
- any: the flexible model of the omnibus test, with the bounds of this module;
- twist: the joint's angle, the load, and the directions of both. The twist of a gear follows the load alone.

What happens once cannot be predicted from other blocks, and has a test of its own (`find_slipped_encoders`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from sim2real.arm.rigid_body import drive_inertia
from sim2real.checks.lack_of_fit import LackOfFit, predict_from_columns
from sim2real.effects.evidence import Context
from sim2real.effects.stage import Stage
from sim2real.inference.fit import parameter_indices, predict_held_out_residual
from sim2real.inference.noise_floor import noise_floor
from sim2real.inference.residual_cells import ResidualCell
from sim2real.inference.search import ModelSearch, fits_by_joint
from sim2real.thresholds import THRESHOLDS

CONSTANCY = THRESHOLDS.constancy

DRIFT = "thermal_drift"  # the one effect whose size may change with time
PLAY = "backlash"  # the one by which torque depends on a past acceleration


@dataclass(frozen=True)
class Misfit:
    """How well the columns of a question predict what the effects leave at one stage of one joint.

    gain: nats, with its standard error over blocks. Mean squares: removed by the columns; left by the effects; null:
    of the residual without effects (in r3 about its mean, for the zero of the motor's encoder is arbitrary).
    """

    question: str
    stage: Stage
    joint: int
    gain: float
    error: float
    removed: float
    left: float
    null: float

    def stands_out(self, least: float) -> bool:
        """Whether it is neither noise nor the usual error of an effect's law, and larger than `least` (RMS)."""
        is_sure = self.gain > max(CONSTANCY.gain, CONSTANCY.gain_errors * self.error)
        return is_sure and self.removed > max(least**2, CONSTANCY.of_left * self.left, CONSTANCY.of_null * self.null)


def find_patterns(search: ModelSearch, members: tuple[int, ...], lack_of_fit: Iterable[LackOfFit]) -> list[Misfit]:
    """All that stands out of what these members leave. lack_of_fit: of `omnibus.omnibus_test`."""
    asked = (
        Misfit(
            "any",
            r.stage,
            r.joint,
            r.gain,
            r.error,
            (r.chosen - r.flexible) / r.rows,
            r.chosen / r.rows,
            r.null / r.rows,
        )
        for r in lack_of_fit
        if r.stage is Stage.DYNAMICS
    )
    return [
        m
        for m in (*measure_misfits(search, members), *asked)
        if m.stands_out(
            CONSTANCY.twist
            if m.stage is Stage.TRANSMISSION
            else noise_floor(search.design.context, m.stage, m.joint, CONSTANCY.torque)
        )
    ]


def measure_misfits(search: ModelSearch, members: tuple[int, ...]) -> Iterator[Misfit]:
    """The results of every question, for every stage of every joint with enough rows."""
    design = search.design
    fits = fits_by_joint(search, members)
    for cell in design.cells:
        if cell.at_reversal or cell.stage is Stage.CONTROLLER or cell.used.sum() < CONSTANCY.blocks:
            continue
        ids, fit = fits[cell.joint]
        left = predict_held_out_residual(cell, ids, fit)
        values = np.zeros(len(design.parameters))
        values[ids] = fit.parameters.mean(axis=0)
        rows = cell.rows
        base = cell.residual[rows] - (cell.residual[rows].mean() if cell.stage is Stage.TRANSMISSION else 0.0)
        for question, columns in _questions(search, cell, members, values):
            gain, error, after = predict_from_columns(design, cell, left, columns)
            removed = float(np.mean(left[rows] ** 2) - np.mean(after[rows] ** 2))
            if question == "memory":
                removed -= _feigned(design.context, cell.joint)
            yield Misfit(
                question,
                cell.stage,
                cell.joint,
                gain,
                error,
                removed,
                float(np.mean(left[rows] ** 2)),
                float(np.mean(base**2)),
            )


def joints_with_play(search: ModelSearch, members: tuple[int, ...]) -> set[int]:
    """Joints whose gears have play, by these members."""
    chosen = (search.design.candidates[m] for m in members)
    return {c.place for c in chosen if c.effect.id == PLAY}


def find_slipped_encoders(search: ModelSearch, members: tuple[int, ...]) -> set[int]:
    """Joints whose two encoders jump apart once and for good: a disc has slipped on its shaft."""
    found, fits, samples = set(), fits_by_joint(search, members), search.design.context.samples
    for cell in search.design.cells:
        if cell.stage is Stage.TRANSMISSION and cell.used.sum() >= CONSTANCY.blocks:
            ids, fit = fits[cell.joint]
            columns, at = parameter_indices(cell, ids)
            left = cell.residual - cell.matrix[:, columns] @ fit.parameters.mean(axis=0)[at]
            if _has_slipped(left, samples.time, samples.trajectory):
                found.add(cell.joint)
    return found


def _has_slipped(left: np.ndarray, time: np.ndarray, trajectory: np.ndarray) -> bool:
    """Whether the largest jump of a residual (n,) rad at times (n,) s of a trajectory comes at once and lasts.

    It lasts if the medians on both sides differ by many times what either side stays within.
    """
    jumps = np.where(trajectory[1:] == trajectory[:-1], np.abs(np.diff(left)), 0.0)
    at = int(np.argmax(jumps)) + 1
    near = (trajectory == trajectory[at]) & (np.abs(time - time[at]) < CONSTANCY.slip_window)
    later = np.arange(len(left)) >= at
    sides = [left[near & side] for side in (~later, later)]
    if min(map(len, sides)) < CONSTANCY.slip_samples:
        return False
    levels = [float(np.median(side)) for side in sides]
    usual = max(float(np.quantile(np.abs(side - level), CONSTANCY.slip_quantile)) for side, level in zip(sides, levels))
    difference, at_once = (
        abs(levels[1] - levels[0]),
        abs(left[at + CONSTANCY.slip_steps - 1] - left[at - CONSTANCY.slip_steps]),
    )
    return (
        difference > max(CONSTANCY.twist, CONSTANCY.slip_lasting * usual)
        and at_once > CONSTANCY.slip_share * difference
    )


def _questions(
    search: ModelSearch, cell: ResidualCell, members: tuple[int, ...], values: np.ndarray
) -> Iterator[tuple[str, np.ndarray]]:
    """(name, columns (n, count)) of the questions to a cell."""
    context, j = search.design.context, cell.joint
    shown, names = [], []
    for m in members:
        candidate = search.design.candidates[m]
        at = np.flatnonzero(np.isin(cell.ids, candidate.ids))
        if at.size:
            place = j if candidate.place is None else candidate.place
            shown.append((cell.matrix[:, at] @ values[cell.ids[at]], place))
            names.append(candidate.effect.id)
    if shown and (cell.stage is not Stage.DYNAMICS or DRIFT not in names):
        elapsed = normalise_time(context, cell)
        yield "size", np.column_stack([c * elapsed**power for c, _ in shown for power in (1, 2)])
    if cell.stage is Stage.DYNAMICS:
        s = context.samples
        if shown:
            speed = np.abs(s.velocity[:, j])
            angle = s.position - s.position.mean(axis=0)
            yield (
                "place",
                np.column_stack([c * factor for c, k in shown for factor in (angle[:, k], angle[:, k] ** 2, speed)]),
            )
        # While a gear crosses its play the drive turns a rotor alone, and then both: that is a memory, and explained.
        if j not in joints_with_play(search, members):
            yield "memory", _past(s.acceleration[:, j], s.trajectory)
    if cell.stage is Stage.TRANSMISSION:
        yield "twist", _twist(context, j)


def normalise_time(context: Context, cell: ResidualCell) -> np.ndarray:
    """Time (n,) of a cell's rows, -1..1 from the beginning of the first recording to the end of the last (`Context.begins`)."""
    source = context.drive if cell.stage in (Stage.CONTROLLER, Stage.DRIVE) else context.samples
    time = source.time + context.begins[source.trajectory]
    return 2 * (time - time.min()) / max(np.ptp(time), 1e-9) - 1


def _feigned(context: Context, joint: int) -> float:
    """Mean square Nm^2 of the noise of a measured acceleration, which is in the residual as well: the accelerations before it
    distinguish it from motion. As in `omnibus`, known of recordings without commands."""
    if context.drive is not None:
        return 0.0
    inertia = drive_inertia(context.arm, np.median(context.samples.position, axis=0))[joint]
    return float(inertia * context.samples.shaking[joint]) ** 2


def _past(values: np.ndarray, trajectory: np.ndarray) -> np.ndarray:
    """values (n,) now and some samples ago (n, 1 + lags), zero before the trajectory began."""
    columns = [values]
    for lag in CONSTANCY.lags:
        late = np.concatenate([np.zeros(lag), values[:-lag]])
        late[lag:][trajectory[lag:] != trajectory[:-lag]] = 0.0
        columns.append(late)
    return np.column_stack(columns)


def _twist(context: Context, joint: int) -> np.ndarray:
    """What a gear's twist may follow (n, count)."""
    s, load = context.samples, context.transmission.load[:, joint]
    angle, usual = s.position[:, joint], np.std(load) + 1e-12
    return np.column_stack(
        [
            np.ones_like(load),
            context.prediction.direction[:, joint],
            s.velocity[:, joint],
            load,
            load * np.abs(load),
            load**3,
            np.tanh(load / usual),
            context.transmission.load_rate[:, joint],
            *(f(k * angle) for k in (1, 2) for f in (np.sin, np.cos)),
        ]
    )
