"""Is what was found the same all the time, and all there is? Questions to what the chosen effects leave.

A fault that the catalogue lacks is often the form of one that it has: a torque scale that fades, a rotor
that is on a spring, a stiffness that begins at some angle. The nearest effect of the catalogue then explains
most, and what it leaves, however small beside it, has a shape. Questions are columns, and an answer is what
they predict of blocks that their fit has not seen (as in `omnibus`):

- size: what each effect does, times time and its square, in every stage: an effect of the catalogue has one
  size. Where a drift is named, that is in r1 only;
- place: the same times its joint's angle, its square, and the joint's speed;
- memory: the joint's acceleration up to a third of a second ago, of which rigid links know nothing;
- any: what `omnibus` asks, of which as much as what is above must be left, and not as much as of the whole
  effect;
- twist: of the joint's angle, the load, and the directions of both: a gear that yields twists with the load
  alone.

What happens once cannot be predicted from other blocks, and is looked for by itself (`slipped`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from np_diagnosis.checks.omnibus import Rest, predicted
from np_diagnosis.effects.base import Context
from np_diagnosis.inference.cells import Cell
from np_diagnosis.inference.fit import places
from np_diagnosis.inference.search import Search, fits_of, held_out
from np_effects.stage import Stage

SURE = 60.0  # nats by which the columns must predict better
ERRORS = 1.5  # standard errors over blocks that these must be: what changes with time is in some blocks only
OF_LEFT = 0.15  # share of the squares that the effects leave
# And of what there was without effects: to a twentieth of its size any model of an effect is off.
OF_ALL = 0.003
MATERIAL = 0.0002  # of the torque limit
TWISTED = 3e-5  # rad of twist, likewise
BESIDE = 10.0  # s on either side of a jump
# A jump lasts where its sides are apart by so many times what they stay within, but for a tenth of their samples.
LASTING, USUAL = 10.0, 0.9
# It comes at once where so many samples on either side of it hold so much of it.
AT_ONCE, MOST_OF = 2, 0.7
LAGS = (1, 2, 3, 4, 6, 8)  # samples
DRIFT = "thermal_drift"  # the one effect whose size may change with time


@dataclass(frozen=True)
class Misfit:
    """What the columns of a question predict of what the effects leave at one stage of one joint: gain nats and
    its standard error over blocks; mean squares: removed by the columns, left by the effects, of the residual
    itself (about its mean in r3, where the zero of the motor's encoder is anybody's)."""

    question: str
    stage: Stage
    joint: int
    gain: float
    error: float
    removed: float
    left: float
    nothing: float

    def stands_out(self, least: float) -> bool:
        """Whether it is no noise, no error of a model that holds, and larger than `least` (RMS)."""
        is_sure = self.gain > max(SURE, ERRORS * self.error)
        return is_sure and self.removed > max(least**2, OF_LEFT * self.left, OF_ALL * self.nothing)


def shapes_left(search: Search, members: tuple[int, ...], rests: Iterable[Rest]) -> list[Misfit]:
    """All that stands out of what these candidates leave; rests: of `omnibus.examine`."""
    arm = search.design.context.arm
    asked = (
        Misfit(
            "any",
            r.stage,
            r.joint,
            r.gain,
            r.error,
            (r.structure - r.flexible) / r.rows,
            r.structure / r.rows,
            r.nothing / r.rows,
        )
        for r in rests
        if r.stage is Stage.DYNAMICS
    )
    return [
        m
        for m in (*misfits(search, members), *asked)
        if m.stands_out(TWISTED if m.stage is Stage.TRANSMISSION else MATERIAL * arm.torque_limit[m.joint])
    ]


def misfits(search: Search, members: tuple[int, ...]) -> Iterator[Misfit]:
    """Every question to every stage of every joint with enough rows."""
    design = search.design
    fits = fits_of(search, members)
    for cell in design.cells:
        if cell.at_reversal or cell.stage is Stage.CONTROLLER or cell.used.sum() < 4:
            continue
        ids, fit = fits[cell.joint]
        left = held_out(cell, ids, fit)
        values = np.zeros(len(design.parameters))
        values[ids] = fit.parameters.mean(axis=0)
        rows = cell.rows
        base = cell.residual[rows] - (cell.residual[rows].mean() if cell.stage is Stage.TRANSMISSION else 0.0)
        for question, columns in _questions(search, cell, members, values):
            gain, error, after = predicted(design, cell, left, columns)
            removed = float(np.mean(left[rows] ** 2) - np.mean(after[rows] ** 2))
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


def slipped(search: Search, members: tuple[int, ...]) -> set[int]:
    """Joints of which the two encoders part at once and for good: a disc has slipped on its shaft."""
    found, fits, samples = set(), fits_of(search, members), search.design.context.samples
    for cell in search.design.cells:
        if cell.stage is Stage.TRANSMISSION and cell.used.sum() >= 4:
            ids, fit = fits[cell.joint]
            columns, at = places(cell, ids)
            left = cell.residual - cell.matrix[:, columns] @ fit.parameters.mean(axis=0)[at]
            if _has_slipped(left, samples.time, samples.trajectory):
                found.add(cell.joint)
    return found


def _has_slipped(left: np.ndarray, time: np.ndarray, trajectory: np.ndarray) -> bool:
    """Whether the largest jump of what is left (n,) rad at times (n,) s of a trajectory lasts on both sides."""
    jumps = np.where(trajectory[1:] == trajectory[:-1], np.abs(np.diff(left)), 0.0)
    at = int(np.argmax(jumps)) + 1
    near = (trajectory == trajectory[at]) & (np.abs(time - time[at]) < BESIDE)
    later = np.arange(len(left)) >= at
    sides = [left[near & side] for side in (~later, later)]
    if min(map(len, sides)) < 10:
        return False
    levels = [float(np.median(side)) for side in sides]
    usual = max(float(np.quantile(np.abs(side - level), USUAL)) for side, level in zip(sides, levels))
    apart, at_once = abs(levels[1] - levels[0]), abs(left[at + AT_ONCE - 1] - left[at - AT_ONCE])
    return apart > max(TWISTED, LASTING * usual) and at_once > MOST_OF * apart


def _questions(
    search: Search, cell: Cell, members: tuple[int, ...], values: np.ndarray
) -> Iterator[tuple[str, np.ndarray]]:
    """(name, columns (n, count)) of what is asked of a cell."""
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
        elapsed = when(context, cell)
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
        yield "memory", _past(s.acceleration[:, j], s.trajectory)
    if cell.stage is Stage.TRANSMISSION:
        yield "twist", _twist(context, j)


def when(context: Context, cell: Cell) -> np.ndarray:
    """Time (n,) of a cell's rows, -1..1 from the beginning of the first recording to the end of the last."""
    source = context.drive if cell.stage in (Stage.CONTROLLER, Stage.DRIVE) else context.samples
    begin = np.concatenate([[0.0], np.cumsum([log.duration for log in context.logs])[:-1]])
    time = source.time + begin[source.trajectory]
    return 2 * (time - time.min()) / max(np.ptp(time), 1e-9) - 1


def _past(values: np.ndarray, trajectory: np.ndarray) -> np.ndarray:
    """values (n,) now and some samples ago (n, 1 + lags), zero before the trajectory began."""
    columns = [values]
    for lag in LAGS:
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
