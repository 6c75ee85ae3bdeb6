"""Structures compete: nothing, every effect at every place, and sets of them, grown from the leaders.

A structure falls into groups of joints that no effect of the arm ties together; each group is scored once, so
that a set of effects in different joints costs nothing new.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from np_diagnosis.effects import Effect
from np_diagnosis.inference.cells import Cell
from np_diagnosis.inference.design import Candidate, Design
from np_diagnosis.inference.fit import Fit, Score, part, places, remaining, score
from np_effects.stage import Stage

WIDTH = 6  # structures that are grown further
BROAD = 3  # effects up to which several structures are grown
CROWD = 2  # effects in a joint
TRIED = 30  # candidates that each structure is grown by
ADDED = 3.0  # nats that an effect must bring beyond its prior odds
CERTAINTY = 1.5  # standard errors over blocks that it must bring
LEAST_SHARE = 0.02  # of the stage's held-out energy at its place, below which an effect is not worth naming
# Of the joint's torque limit, likewise; no sensor blurs what a controller says of itself.
VISIBLE_OF = {Stage.CONTROLLER: 0.00001, Stage.DRIVE: 0.0001, Stage.DYNAMICS: 0.0001}
VISIBLE_TWIST = 5e-7  # rad, RMS: a sixth of the noise that a sample has of two encoders of 10 urad
TIE = 2.0  # nats within which fewer parameters are preferred


@dataclass(frozen=True, eq=False)
class Structure:
    """Candidates by number, log predictive density (m,) of the blocks, and what priors of nuisances cost."""

    members: tuple[int, ...]
    density: np.ndarray
    penalty: float

    @property
    def total(self) -> float:
        """Log predictive density, nats."""
        return float(self.density.sum() - self.penalty)


@dataclass(eq=False)
class Search:
    """All structures tried, best of each size; `chosen` is the simplest that no larger one beats clearly.

    intervals: (values, half widths) of the parameters of groups whose size was estimated.
    """

    design: Design
    tried: dict[tuple[int, ...], Structure] = field(default_factory=dict)
    intervals: dict[tuple, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    _groups: dict[tuple, tuple[Score, float]] = field(default_factory=dict)
    _reaches: dict[int, tuple[int, ...]] = field(default_factory=dict)

    def structure(self, members: tuple[int, ...]) -> Structure:
        """The structure of these candidates, scored when first asked for."""
        members = tuple(sorted(members))
        if members not in self.tried:
            density, penalty = 0.0, 0.0
            for joints, inside in self.groups(members):
                result, cost = self.group(joints, inside)
                density, penalty = density + result.density, penalty + cost
            self.tried[members] = Structure(members, density, penalty)
        return self.tried[members]

    def on(self, design: Design, changed: Collection[int]) -> Search:
        """A search of a design whose cells of the joints `changed` are others; of the rest it knows the same."""
        return Search(design, _groups={k: v for k, v in self._groups.items() if not set(k[0]) & set(changed)})

    def groups(self, members: tuple[int, ...]) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
        """(joints, members) of each part that shares no parameter with the others."""
        chosen = [(m, self.design.candidates[m]) for m in members]
        tied = {j for _, c in chosen if c.joint is None for j in self.reach(c)}
        parts = []
        if tied:
            parts.append((tuple(sorted(tied)), tuple(m for m, c in chosen if c.joint is None or c.joint in tied)))
        for joint in range(len(self.design.context.arm)):
            if joint not in tied:
                parts.append(((joint,), tuple(m for m, c in chosen if c.joint == joint)))
        return parts

    def group(self, joints: tuple[int, ...], inside: tuple[int, ...]) -> tuple[Score, float]:
        """Score of some joints with these candidates, and the cost of their nuisances."""
        key = (joints, inside)
        if key not in self._groups:
            design = self.design
            ids = self.ids(joints, inside)
            cells = [cell for j in joints for cell in design.of(j)]
            result = score(cells, ids, design.parameters)
            count = len(ids) - sum(len(design.candidates[m].ids) for m in inside)
            mean = np.median(result.fit.parameters[:, :count], axis=0)
            prior = np.array([design.parameters[i].prior for i in ids[:count]])
            centre = np.array([design.parameters[i].centre for i in ids[:count]])
            self._groups[key] = (result, float(0.5 * np.square((mean - centre) / prior).sum()))
        return self._groups[key]

    def scored(self, joints: tuple[int, ...]) -> list[tuple[int, ...]]:
        """Candidates inside of each group of exactly these joints that was scored."""
        return [inside for other, inside in self._groups if other == joints]

    def group_value(self, joints: tuple[int, ...], inside: tuple[int, ...]) -> float:
        """Log predictive density and prior of one group."""
        result, cost = self.group(joints, inside)
        return float(result.density.sum() - cost + sum(self.odds(m) for m in inside))

    def ids(self, joints: tuple[int, ...], inside: tuple[int, ...]) -> np.ndarray:
        """Parameters of a group: nuisances of its joints, then those of its candidates in order."""
        design = self.design
        return np.concatenate([*(design.nuisances[j] for j in joints), *(design.candidates[m].ids for m in inside)])

    def reach(self, candidate: Candidate) -> tuple[int, ...]:
        """Joints in which an effect of the arm shows at all."""
        if id(candidate) in self._reaches:
            return self._reaches[id(candidate)]
        found = []
        for cell in self.design.cells:
            columns = np.flatnonzero(np.isin(cell.ids, candidate.ids))
            if columns.size and (np.einsum("bii->i", cell.test[:, columns[:, None], columns]) > 0).any():
                found.append(cell.joint)
        self._reaches[id(candidate)] = tuple(sorted(set(found)))
        return self._reaches[id(candidate)]

    def odds(self, number: int) -> float:
        """Log prior odds of a candidate: one effect among as many, and a preference for few parameters."""
        return -np.log(40.0) - (len(self.design.candidates[number].ids) - 1.0)

    def value(self, structure: Structure) -> float:
        """Log predictive density and prior."""
        return structure.total + sum(self.odds(m) for m in structure.members)

    def run(self, width: int = WIDTH, largest: int | None = None) -> Structure:
        """Grow structures: broadly while they are small, then the best one only; returns the chosen one."""
        chosen = self.structure(())
        front = [chosen]
        for size in range(1, (largest or CROWD * len(self.design.context.arm)) + 1):
            grown: dict[tuple[int, ...], Structure] = {}
            for parent in front:
                for number in self.promising(parent, TRIED if size > 1 else 2 * TRIED):
                    if self._is_new(parent, number):
                        child = self.structure((*parent.members, number))
                        grown[child.members] = child
            if not grown:
                break
            ranked = sorted(grown.values(), key=self.value, reverse=True)
            ranked = [s for s in ranked if not any(self.is_trifle(s, m) for m in s.members)]
            if not ranked:
                break
            front = _distinct(ranked, self.design, width if size < BROAD else 1)
            best = ranked[0]
            near = [s for s in ranked[: 4 * width] if self.value(s) > self.value(best) - TIE]
            best = min(near, key=lambda s: (self._parameters(s), -self.value(s)))
            if self.beats(best, chosen):
                chosen = best
            elif len(chosen.members) < size - 1:
                break
        return self.pruned(chosen)

    def promising(self, parent: Structure, count: int) -> list[int]:
        """Candidates whose addition would raise the likelihood most, to second order, best first."""
        design = self.design
        size = len(design.parameters)
        normal, slope = np.zeros((size, size)), np.zeros(size)
        inside = np.zeros(size, bool)
        values = np.zeros(size)
        variance = {}
        for joints, members in self.groups(parent.members):
            result, _ = self.group(joints, members)
            ids = self.ids(joints, members)
            inside[ids] = True
            values[ids] = result.fit.parameters.mean(axis=0)
            cells = [cell for j in joints for cell in design.of(j)]
            variance |= {id(c): v.mean() for c, v in zip(cells, result.fit.variance)}
        for cell, gram in zip(design.cells, (cell.total for cell in design.cells)):
            v = variance[id(cell)]
            normal[np.ix_(cell.ids, cell.ids)] += gram[:-1, :-1] / v
            slope[cell.ids] += (gram[:-1, -1] - gram[:-1, :-1] @ values[cell.ids]) / v
        prior = np.array([p.prior for p in design.parameters])
        normal[np.diag_indices(size)] += prior**-2
        # What the parameters in use can take up themselves is not gained.
        used = np.flatnonzero(inside)
        taken = np.linalg.solve(normal[np.ix_(used, used)], normal[used])
        rest = slope - taken.T @ slope[used]
        gains = []
        for c in design.candidates:
            i = c.ids
            left = normal[np.ix_(i, i)] - normal[np.ix_(used, i)].T @ taken[:, i]
            centre = np.array([design.parameters[k].centre for k in i]) / prior[i] ** 2
            gains.append(0.5 * rest[i] @ np.linalg.solve(left + 1e-9 * np.diag(np.diag(normal)[i]), rest[i] + centre))
        ranked = np.argsort(gains)[::-1]
        return [int(n) for n in ranked[:count]]

    def beats(self, one: Structure, other: Structure) -> bool:
        """Whether `one` predicts clearly better, beyond its prior odds and by an amount worth naming."""
        difference = one.density - other.density
        gain = one.total - other.total
        error = float(np.sqrt(len(difference)) * difference.std(ddof=1))
        extra = sum(self.odds(m) for m in one.members) - sum(self.odds(m) for m in other.members)
        is_sure = gain > CERTAINTY * error or gain > 40.0
        return is_sure and gain + extra > ADDED and self.is_material(one, other)

    def is_material(self, one: Structure, other: Structure) -> bool:
        """Whether some stage of some joint gets better by an amount that matters, through what is no trifle."""
        if any(self.is_trifle(one, m) for m in one.members if m not in other.members):
            return False
        before, after = self.energies(other.members), self.energies(one.members)
        for cell, old, new in zip(self.design.cells, before, after):
            rows = max(cell.rows.sum(), 1)
            limit = self.design.context.arm.torque_limit[cell.joint]
            least = VISIBLE_TWIST**2 if cell.stage is Stage.TRANSMISSION else (VISIBLE_OF[cell.stage] * limit) ** 2
            if old - new > max(LEAST_SHARE * old, least * rows):
                return True
        return False

    def is_trifle(self, structure: Structure, member: int) -> bool:
        """Whether a member's parameters all are within what any arm has."""
        ids, shape = self.design.candidates[member].ids, self.design.candidates[member].effect.shape
        least = np.array([self.design.parameters[i].least for i in ids])
        if shape is not None and shape.least:
            least = least + shape.least / shape.value
        if not least.any():
            return False
        joints, inside = next(g for g in self.groups(structure.members) if member in g[1])
        group = self.ids(joints, inside)
        found = self.group(joints, inside)[0].fit.parameters.mean(axis=0)
        values = found[np.isin(group, ids)] + absorbed(self.design, group, found, self.design.candidates[member].effect)
        return bool((np.abs(values) <= least).all())

    def energies(self, members: tuple[int, ...]) -> list[float]:
        """Squared held-out residual of each cell, before whitening, of blocks predicted from the others."""
        fits = {}
        for joints, inside in self.groups(tuple(sorted(members))):
            result, _ = self.group(joints, inside)
            for j in joints:
                fits[j] = (self.ids(joints, inside), result.fit)
        return [energy(cell, *fits[cell.joint]) for cell in self.design.cells]

    def _is_new(self, parent: Structure, number: int) -> bool:
        mine = self.design.candidates[number]
        for m in parent.members:
            other = self.design.candidates[m]
            if m == number or (
                other.effect.id == mine.effect.id
                and other.joint == mine.joint
                and other.effect.component == mine.effect.component
            ):
                return False
        here = [self.design.candidates[m] for m in (*parent.members, number)]
        crowds = [sum(c.place == j for c in here) for j in range(len(self.design.context.arm))]
        return max(crowds) <= CROWD and bool(mine.joint is not None or self.reach(mine))

    def _parameters(self, structure: Structure) -> int:
        return sum(len(self.design.candidates[m].ids) + 1 for m in structure.members)

    def pruned(self, chosen: Structure) -> Structure:
        """The structure without what is superfluous in it, and with simpler effects that do as well."""
        for m in chosen.members:
            rest = self.structure(tuple(n for n in chosen.members if n != m))
            if not self.beats(chosen, rest):
                return self.pruned(rest)
            size = len(self.design.candidates[m].ids)
            simpler = [
                self.structure((*rest.members, n))
                for n in self.promising(rest, TRIED)
                if len(self.design.candidates[n].ids) < size and self._is_new(rest, n)
            ]
            equals = [s for s in simpler if not self.beats(chosen, s)]
            if equals:
                return self.pruned(max(equals, key=self.value))
        return chosen


def absorbed(design: Design, ids: np.ndarray, values: np.ndarray, effect: Effect) -> float:
    """What the nuisances that say the same have taken of an effect, on average over the joints: a delay of commands
    is all there is of it; states are late by what is beyond the delay of the commands."""
    beside = [n for n, i in enumerate(ids) if design.parameters[i].name == effect.absorbs]
    if not beside:
        return 0.0
    known = 0.0 if effect.absorbs == "command_delay" else design.parameters[ids[beside[0]]].centre
    return float(np.mean(values[beside])) - known


def energy(cell: Cell, ids: np.ndarray, fit: Fit) -> float:
    """Sum of squares of `held_out` over the rows that count."""
    columns, at = places(cell, ids)
    return float(remaining(part(cell.plain, columns), fit.parameters[:, at]).sum() + cell.outside)


def fits_of(search: Search, members: tuple[int, ...]) -> dict[int, tuple[np.ndarray, Fit]]:
    """Parameters, and their fit, of the group that each joint is in."""
    return {
        j: (search.ids(joints, inside), search.group(joints, inside)[0].fit)
        for joints, inside in search.groups(members)
        for j in joints
    }


def held_out(cell: Cell, ids: np.ndarray, fit: Fit) -> np.ndarray:
    """Residual (n,) of a cell, each block from a fit that has not seen it; as it is where in no block."""
    columns, at = places(cell, ids)
    values = np.where((cell.block >= 0)[:, None], fit.parameters[np.maximum(cell.block, 0)][:, at], 0.0)
    return cell.residual - sum((cell.matrix[:, k] * values[:, n] for n, k in enumerate(columns)), 0.0)


def _distinct(ranked: list[Structure], design: Design, width: int) -> list[Structure]:
    """The leaders, variants of the same effects at the same places counted once."""
    kept, seen = [], set()
    for structure in ranked:
        name = tuple(
            sorted(
                (design.candidates[m].effect.id, str(design.candidates[m].joint), design.candidates[m].effect.component)
                for m in structure.members
            )
        )
        if name not in seen:
            seen.add(name)
            kept.append(structure)
        if len(kept) == width:
            break
    return kept
