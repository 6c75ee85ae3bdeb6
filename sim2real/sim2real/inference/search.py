"""Models compete: the empty one, every effect at every place, and sets of effects, grown from the best ones.

A model is a set of candidates. It falls apart into groups of joints that share no parameter; each group is scored
once and remembered, so that a model whose effects sit in different joints costs nothing new.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sim2real.effects import ARM_EFFECTS
from sim2real.effects.regressor import EffectRegressor
from sim2real.inference import screening as screen
from sim2real.inference.fit import HeldOutScore, ParameterFit, held_out_energy, parameter_indices, score_held_out
from sim2real.inference.noise_floor import noise_floor
from sim2real.inference.regression import Candidate, RegressionProblem
from sim2real.thresholds import THRESHOLDS

SEARCH = THRESHOLDS.search
WIDTH = 6  # models of one size that are extended
BROAD = 3  # effects, size up to which several models are extended
FIRST_TRIED = 60  # candidates by which the empty model is extended
TIED = 4  # widths of leaders among which a tie is looked for


@dataclass(frozen=True, eq=False)
class ScoredModel:
    """A set of candidates that competes with other sets.

    members: the candidates by number; density (m,): held-out log predictive density of each block, nats; penalty:
    nats by which the nuisances lie off their priors.
    """

    members: tuple[int, ...]
    density: np.ndarray
    penalty: float

    @property
    def total(self) -> float:
        """Log predictive density, nats."""
        return float(self.density.sum() - self.penalty)


@dataclass(eq=False)
class ModelSearch:
    """The models of a design, each scored when it is first requested.

    tried: models by their members. intervals: (values, half widths) of the parameters of the groups that were
    estimated (`estimates.estimate`). background: the friction curves that every model has (`with_background`).
    """

    design: RegressionProblem
    background: tuple[int, ...] = ()
    tried: dict[tuple[int, ...], ScoredModel] = field(default_factory=dict)
    intervals: dict[tuple, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    _groups: dict[tuple, tuple[HeldOutScore, float]] = field(default_factory=dict)
    _reaches: dict[int, tuple[int, ...]] = field(default_factory=dict)

    def model(self, members: tuple[int, ...]) -> ScoredModel:
        """The model of these candidates by number, in any order."""
        members = tuple(sorted(members))
        if members not in self.tried:
            density, penalty = 0.0, 0.0
            for joints, inside in self.groups(members):
                result, cost = self.group(joints, inside)
                density, penalty = density + result.density, penalty + cost
            self.tried[members] = ScoredModel(members, density, penalty)
        return self.tried[members]

    def with_regression(self, design: RegressionProblem, changed: int) -> ModelSearch:
        """A search of another design, which differs in the columns of one candidate only: scores without it are kept."""
        kept = {k: v for k, v in self._groups.items() if changed not in k[1]}
        return ModelSearch(design, self.background, _groups=kept)

    def with_background(self) -> ModelSearch:
        """A search that begins with a friction curve at every joint, where most joints need theirs beside the best two effects.

        Such friction is no fault: other effects are tested against what it leaves, each fitted together with it. A wrong
        load or a tilted base pulls at most joints too, but is one effect: beside it no curve is needed.
        """
        curves = tuple(n for n, c in enumerate(self.design.candidates) if is_curve(c))
        best = self.run(1, 2)
        needed = sum(self.predicts_better(self.model((*best.members, n)), best) for n in curves)
        return ModelSearch(self.design, curves, _groups=self._groups) if 2 * needed > len(curves) else self

    def groups(self, members: tuple[int, ...]) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
        """(joints, members) of each group of joints that shares no parameter with the others."""
        chosen = [(m, self.design.candidates[m]) for m in members]
        coupled = {j for _, c in chosen if c.joint is None for j in self.joints_affected(c)}
        parts = []
        if coupled:
            parts.append((tuple(sorted(coupled)), tuple(m for m, c in chosen if c.joint is None or c.joint in coupled)))
        for joint in range(len(self.design.context.arm)):
            if joint not in coupled:
                parts.append(((joint,), tuple(m for m, c in chosen if c.joint == joint)))
        return parts

    def group(self, joints: tuple[int, ...], inside: tuple[int, ...]) -> tuple[HeldOutScore, float]:
        """Score of some joints with these candidates, and the penalty of their nuisances, nats."""
        key = (joints, inside)
        if key not in self._groups:
            design = self.design
            ids = self.ids(joints, inside)
            cells = [cell for j in joints for cell in design.cells_of(j)]
            result = score_held_out(cells, ids, design.parameters)
            count = len(ids) - sum(len(design.candidates[m].ids) for m in inside)
            mean = np.median(result.fit.parameters[:, :count], axis=0)
            prior = np.array([design.parameters[i].prior for i in ids[:count]])
            centre = np.array([design.parameters[i].centre for i in ids[:count]])
            self._groups[key] = (result, float(0.5 * np.square((mean - centre) / prior).sum()))
        return self._groups[key]

    def list_scored_groups(self, joints: tuple[int, ...]) -> list[tuple[int, ...]]:
        """The candidates of each group of exactly these joints that has been scored."""
        return [inside for other, inside in self._groups if other == joints]

    def group_value(self, joints: tuple[int, ...], inside: tuple[int, ...]) -> float:
        """Held-out log predictive density of one group with its log prior, nats."""
        result, cost = self.group(joints, inside)
        return float(result.density.sum() - cost + sum(self.log_prior(m) for m in inside))

    def ids(self, joints: tuple[int, ...], inside: tuple[int, ...]) -> np.ndarray:
        """Parameters of a group: nuisances of its joints, then those of its candidates in order."""
        design = self.design
        return np.concatenate([*(design.nuisances[j] for j in joints), *(design.candidates[m].ids for m in inside)])

    def joints_affected(self, candidate: Candidate) -> tuple[int, ...]:
        """The joints, by number, in which a candidate has a column that is not zero."""
        if id(candidate) in self._reaches:
            return self._reaches[id(candidate)]
        found = []
        for cell in self.design.cells:
            columns = np.flatnonzero(np.isin(cell.ids, candidate.ids))
            if columns.size and (np.einsum("bii->i", cell.test[:, columns[:, None], columns]) > 0).any():
                found.append(cell.joint)
        self._reaches[id(candidate)] = tuple(sorted(set(found)))
        return self._reaches[id(candidate)]

    def log_prior(self, number: int) -> float:
        """Log prior of a candidate, nats: one effect of many that are equally probable, the less so the more
        parameters it has."""
        count = len(self.design.candidates[number].ids)
        return -np.log(SEARCH.prior_candidates) - SEARCH.prior_parameter * (count - 1.0)

    def value(self, model: ScoredModel) -> float:
        """Held-out log predictive density of a model with its log prior, nats."""
        return model.total + sum(self.log_prior(m) for m in model.members)

    def run(self, width: int = WIDTH, largest: int | None = None) -> ScoredModel:
        """Grow models effect by effect and return the chosen one: the simplest that no larger one beats clearly.

        width: models that are grown further while they are small; later only the best one is. largest: effects of
        the largest model; None: as many as all joints may have together.
        """
        chosen = self.model(self.background)
        front = [chosen]
        for size in range(1, (largest or SEARCH.per_joint * len(self.design.context.arm)) + 1):
            grown: dict[tuple[int, ...], ScoredModel] = {}
            for parent in front:
                for number in self.rank_candidates(parent, SEARCH.tried if size > 1 else FIRST_TRIED):
                    if self.can_extend(parent, number):
                        child = self.model((*parent.members, number))
                        grown[child.members] = child
            if not grown:
                break
            ranked = sorted(grown.values(), key=self.value, reverse=True)
            ranked = [s for s in ranked if not any(self.is_negligible(s, m) for m in s.members)]
            if not ranked:
                break
            front = _distinct(ranked, self.design, width if size < BROAD else 1)
            best = ranked[0]
            near = [s for s in ranked[: TIED * width] if self.value(s) > self.value(best) - SEARCH.tie]
            best = min(near, key=lambda s: (self._parameters(s), -self.value(s)))
            if self.predicts_better(best, chosen):
                chosen = best
            elif len(chosen.members) - len(self.background) < size - 1:
                break
        return self.prune(chosen)

    def rank_candidates(self, parent: ScoredModel, count: int) -> list[int]:
        """Candidates whose addition would raise the likelihood most (`screen.gains`), best first: `count` of them, and of
        the first model the best of each stage of each joint too, where it would be worth its prior: none is crowded out by
        what goes on elsewhere."""
        groups = self.groups(parent.members)
        gains = screen.likelihood_gains(self.design, [(j, self.ids(j, m), self.group(j, m)[0].fit) for j, m in groups])
        # Curves are tried in the place of what was found (`use_curves`): they would crowd out the laws that they can imitate.
        ranked = [int(n) for n in np.argsort(gains)[::-1] if not is_curve(self.design.candidates[n])]
        found, seen = ranked[:count], set()
        for n in ranked if parent.members == self.background else ():
            if gains[n] + self.log_prior(n) < SEARCH.gain:
                break
            candidate = self.design.candidates[n]
            places = {(stage, candidate.place, candidate.effect.is_arm) for stage in candidate.effect.columns}
            if not places <= seen and n not in found[:count]:
                found.append(n)
            seen |= places
        return found

    def predicts_better(self, one: ScoredModel, other: ScoredModel) -> bool:
        """Whether `one` predicts unseen blocks clearly better than `other`.

        Its gain must exceed what the log priors require, be sure (many standard errors over the blocks), and come
        with a residual that falls by an amount that matters.
        """
        difference = one.density - other.density
        gain = one.total - other.total
        error = float(np.sqrt(len(difference)) * difference.std(ddof=1))
        extra = sum(self.log_prior(m) for m in one.members) - sum(self.log_prior(m) for m in other.members)
        is_sure = gain > SEARCH.gain_errors * error or gain > SEARCH.sure_gain
        return is_sure and gain + extra > SEARCH.gain and self.is_material(one, other)

    def is_material(self, one: ScoredModel, other: ScoredModel) -> bool:
        """Whether a residual falls by an amount that matters, by effects none of which is negligible."""
        new = [m for m in one.members if m not in other.members]
        if any(self.is_negligible(one, m) for m in new):
            return False
        effects = [self.design.candidates[m].effect for m in new]
        acts = max((effect.acts for effect in effects), default=1.0)
        # A link's inertia acts in all of a joint's rows. Those about its reversals are few, and show most of what it can
        # take up in place of errors that each joint has to explain by itself.
        is_pooled = all(effect.id == "link_inertia" for effect in effects)
        sums: dict[tuple, np.ndarray] = {}
        for cell, old, left in zip(self.design.cells, self.energies(other.members), self.energies(one.members)):
            key = cell.stage, cell.joint, cell.at_reversal and not is_pooled
            sums[key] = sums.get(key, 0.0) + np.array([old, left, max(cell.rows.sum(), 1)])
        for (stage, joint, _), (old, left, rows) in sums.items():
            least = noise_floor(self.design.context, stage, joint)
            if old - left > acts * max(SEARCH.energy_share * old, least**2 * rows):
                return True
        return False

    def is_negligible(self, model: ScoredModel, member: int) -> bool:
        """Whether a member is so small that any arm has as much of it, or does nothing that matters at any stage."""
        ids, effect = self.design.candidates[member].ids, self.design.candidates[member].effect
        nonlinear = effect.nonlinear
        least = np.array([self.design.parameters[i].least for i in ids])
        if nonlinear is not None and nonlinear.least:
            least = least + nonlinear.least / nonlinear.value
        joints, inside = next(g for g in self.groups(model.members) if member in g[1])
        group = self.ids(joints, inside)
        found = self.group(joints, inside)[0].fit.parameters.mean(axis=0)
        own = np.isin(group, ids)
        values = found[own] + average_absorbed(self.design, group, found, effect)
        return bool((np.abs(values) <= least).all()) or not self._is_visible(group[own], values, effect.acts)

    def _is_visible(self, ids: np.ndarray, values: np.ndarray, acts: float = 1.0) -> bool:
        """Whether parameters of these values do, by themselves and in the share `acts` of rows, anything that matters at any
        stage of any joint."""
        for cell in self.design.cells:
            columns, at = parameter_indices(cell, ids)
            if len(columns):
                done = values[at] @ cell.unwhitened[columns[:, None], columns] @ values[at]
                if done > acts * noise_floor(self.design.context, cell.stage, cell.joint) ** 2 * cell.test_rows.sum():
                    return True
        return False

    def energies(self, members: tuple[int, ...]) -> list[float]:
        """Sum of the squared held-out residuals of each cell, before whitening."""
        fits = fits_by_joint(self, members)
        return [held_out_energy(cell, *fits[cell.joint]) for cell in self.design.cells]

    def can_extend(self, parent: ScoredModel, number: int) -> bool:
        """Whether a candidate explains something that a model does not explain yet, at a joint where there is room for it."""
        mine = self.design.candidates[number]
        for m in parent.members:
            other = self.design.candidates[m]
            if m == number or (
                mine.effect.id in (other.effect.id, *ARM_EFFECTS[other.effect.id].special_cases)
                and other.joint == mine.joint
                and other.effect.component == mine.effect.component
            ):
                return False
        here = [self.design.candidates[m] for m in (*parent.members, number) if m not in self.background]
        crowds = [sum(c.place == j for c in here) for j in range(len(self.design.context.arm))]
        return max(crowds) <= SEARCH.per_joint and bool(mine.joint is not None or self.joints_affected(mine))

    def _parameters(self, model: ScoredModel) -> int:
        return sum(len(self.design.candidates[m].ids) + 1 for m in model.members)

    def _may_replace(self, simpler: ScoredModel, chosen: ScoredModel) -> bool:
        """Whether a simpler effect in another's place is either of the same module or about as probable.

        How little a residual changes measures what a patch is worth, and between an effect and its own special case that decides
        (plain friction and asymmetric friction). Where to look for the cause (a constant torque of the drive, or asymmetric
        friction) is a question of probability.
        """
        modules = [
            {ARM_EFFECTS[self.design.candidates[m].effect.id].module for m in one.members if m not in other.members}
            for one, other in ((simpler, chosen), (chosen, simpler))
        ]
        return modules[0] == modules[1] or self.value(simpler) > self.value(chosen) - SEARCH.tie

    def prune(self, chosen: ScoredModel) -> ScoredModel:
        """The model without members that it does not need, and with simpler effects where those do as well."""
        for m in chosen.members:
            fewer = self.model(tuple(n for n in chosen.members if n != m))
            if not self.predicts_better(chosen, fewer):
                return self.prune(fewer)
            if m in self.background:
                continue
            size = len(self.design.candidates[m].ids)
            simpler = {
                n: self.model((*fewer.members, n))
                for n in self.rank_candidates(fewer, SEARCH.tried)
                if len(self.design.candidates[n].ids) < size and self.can_extend(fewer, n)
            }
            # What any arm has explains nothing in another's place, however well it predicts.
            equals = [
                s
                for n, s in simpler.items()
                if not self.predicts_better(chosen, s) and self._may_replace(s, chosen) and not self.is_negligible(s, n)
            ]
            if equals:
                return self.prune(max(equals, key=self.value))
        return chosen

    def use_curves(self, chosen: ScoredModel) -> ScoredModel:
        """The model with a free curve in the place of its special cases, joint by joint, where that predicts clearly better."""
        if self.background:  # has them all
            return chosen
        candidates, found = self.design.candidates, chosen
        for number, curve in enumerate(candidates):
            names = ARM_EFFECTS[curve.effect.id].special_cases
            if names:
                others = (
                    m
                    for m in found.members
                    if candidates[m].joint != curve.joint or candidates[m].effect.id not in names
                )
                trial = self.model((*others, number))
                found = trial if self.predicts_better(trial, found) else found
        return found if found is chosen else self.prune(found)


def is_curve(candidate: Candidate) -> bool:
    """Whether a candidate is a free curve with other effects as its special cases."""
    return bool(ARM_EFFECTS[candidate.effect.id].special_cases)


def average_absorbed(design: RegressionProblem, ids: np.ndarray, values: np.ndarray, effect: EffectRegressor) -> float:
    """The part of an effect that its nuisance (`Signature.absorbs`) has taken up, on average over the joints.

    Of a delay of commands that is all of the nuisance; of a delay of states it is what the nuisance has beyond the
    delay of the commands, its centre.
    """
    beside = [n for n, i in enumerate(ids) if design.parameters[i].name == effect.absorbs]
    if not beside:
        return 0.0
    known = 0.0 if effect.absorbs == "command_delay" else design.parameters[ids[beside[0]]].centre
    return float(np.mean(values[beside])) - known


def fits_by_joint(search: ModelSearch, members: tuple[int, ...]) -> dict[int, tuple[np.ndarray, ParameterFit]]:
    """Parameters, and their fit, of the group that each joint is in."""
    return {
        j: (search.ids(joints, inside), search.group(joints, inside)[0].fit)
        for joints, inside in search.groups(tuple(sorted(members)))
        for j in joints
    }


def _distinct(ranked: list[ScoredModel], design: RegressionProblem, width: int) -> list[ScoredModel]:
    """The first `width` models, counting variants of the same effects at the same places once."""
    kept, seen = [], set()
    for model in ranked:
        name = tuple(
            sorted(
                (design.candidates[m].effect.id, str(design.candidates[m].joint), design.candidates[m].effect.component)
                for m in model.members
            )
        )
        if name not in seen:
            seen.add(name)
            kept.append(model)
        if len(kept) == width:
            break
    return kept
