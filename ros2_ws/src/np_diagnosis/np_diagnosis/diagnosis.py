"""From logs to an answer: where the gap is, which effects explain it, how far they shrink it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_diagnosis.arm.model import Arm, panda
from np_diagnosis.checks.constancy import shapes_left, slipped
from np_diagnosis.checks.omnibus import Rest, examine
from np_diagnosis.checks.shrinkage import Gap, measure
from np_diagnosis.checks.standstill import ageing
from np_diagnosis.effects import Context, Effect
from np_diagnosis.effects.sensing import quantised
from np_diagnosis.inference.context import make_context
from np_diagnosis.inference.design import Design, make_design
from np_diagnosis.inference.estimates import Estimate, estimate
from np_diagnosis.inference.loop_delay import settle_delay
from np_diagnosis.inference.ranking import alternatives, larger, probabilities
from np_diagnosis.inference.search import Search, Structure
from np_diagnosis.inference.settling import settle_shapes
from np_diagnosis.recordings.signals import Log
from np_effects.stage import Stage

CERTAIN = 0.8  # probability of an effect from which on it counts as identified
EXPLAINED = 0.8  # of what is predictable at all: a structure that explains less is no explanation
LEFT_SURE = 25.0  # nats by which a flexible model must predict better for something to be left
COLOURED = 1.5  # times its white part, what is left of r2 is no noise
MOST = 0.9  # of what is no white noise, explained by a structure that may stand
COARSE = 2e-5  # rad, a step of an encoder that shows
MANY = 2  # effects of a joint up to which they explain it
NEEDED = 0.05  # of what a stage of a joint shows, which its gap would grow by without an effect
EXTREME = 0.98  # of the largest that a parameter may be
MATERIAL = 0.0005  # of the torque limit: what is left below is nothing


@dataclass(frozen=True, eq=False)
class Finding:
    """An effect at a component (joint, or "arm"): probability, parameters by name, the share by which it
    alone shrinks the held-out gap, the ids that these data cannot tell from it, whether it is of the chosen
    structure, and how much of the gap's energy it removes there. larger: ids that contain it
    (`ranking.larger`) and say the same; beside: their probability."""

    effect: Effect
    component: str
    probability: float
    parameters: dict[str, Estimate]
    shrink: float
    equivalent_to: tuple[str, ...]
    is_chosen: bool
    energy: float
    larger: tuple[str, ...] = ()
    beside: float = 0.0

    @property
    def rivals(self) -> tuple[str, ...]:
        """Of `equivalent_to`, what says something else."""
        return tuple(name for name in self.equivalent_to if name not in self.larger)

    @property
    def is_open(self) -> bool:
        """Whether something else may as well be the cause."""
        return self.probability + self.beside < CERTAIN or bool(self.rivals)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The answer. findings: the chosen effects, then alternatives; rests: what a flexible model still finds;
    unexplained: joints by number that have a gap without an explanation."""

    verdict: str
    findings: tuple[Finding, ...]
    gap: Gap
    rests: tuple[Rest, ...]
    unexplained: tuple[int, ...]
    context: Context
    design: Design
    search: Search
    chosen: Structure


def diagnose(logs: list[Log], arm: Arm | None = None, seed: int = 0, quick: bool = False) -> Diagnosis:
    """Compare logs with the nominal arm. Raises ValueError where they are too short.

    quick: single effects and what is left only.
    """
    context = make_context(logs, arm or panda())
    design = settle_delay(make_design(context))
    search = Search(design)
    search, chosen = settle_shapes(search, search.run(*((1, 1) if quick else ())))
    design = search.design
    rests = examine(search, chosen.members)
    odd = [_crowded(search, chosen), _extreme(search, chosen), ageing(search, chosen.members)]
    if not quick:
        odd += [{m.joint for m in shapes_left(search, chosen.members, rests)}, slipped(search, chosen.members)]
    unexplained = tuple(sorted(set(_unexplained(rests, design)).union(*odd)))
    gap = measure(search, chosen, seed)
    found = _findings(search, chosen, gap, seed, quick)
    return Diagnosis(
        _verdict(found, unexplained, rests, design),
        tuple(found),
        gap,
        tuple(rests),
        unexplained,
        context,
        design,
        search,
        chosen,
    )


def _crowded(search: Search, chosen: Structure) -> set[int]:
    """Joints that more than `MANY` effects are needed for, the arm's own counted: so many can describe anything."""
    cells, count = search.design.cells, np.zeros(len(search.design.context.arm), int)
    before, after = np.array(search.energies(())), np.array(search.energies(chosen.members))
    for m in chosen.members:
        less = np.array(search.energies(tuple(n for n in chosen.members if n != m)))
        needed = {c.joint for c, b, a, rise in zip(cells, before, after, less) if rise - a > NEEDED * b}
        count[list(needed)] += 1
    return set(np.flatnonzero(count > MANY).tolist())


def _extreme(search: Search, chosen: Structure) -> set[int]:
    """Joints at which an effect would have to be as large as none is: the best fit is then no explanation."""
    found = set()
    for joints, inside in search.groups(chosen.members):
        ids, fitted = search.ids(joints, inside), search.group(joints, inside)[0].fit.parameters.mean(axis=0)
        for m in inside:
            candidate = search.design.candidates[m]
            places = [int(np.flatnonzero(ids == i)[0]) for i in candidate.ids]
            shape = candidate.effect.shape
            is_beyond = shape is not None and shape.value > shape.upper
            if is_beyond or any(
                abs(fitted[at]) > EXTREME * p.upper
                for at, p in zip(places, candidate.effect.parameters)
                if p.name != "share"
            ):
                found |= set(search.reach(candidate)) if candidate.place is None else {candidate.place}
    return found


def _unexplained(rests: list[Rest], design: Design) -> tuple[int, ...]:
    """Joints at which the chosen structure leaves what is no noise: a flexible model predicts it, it has a memory
    that the noise of a clean arm has not, or the drive does now and then what no noise does."""
    found = set()
    for rest in rests:
        limit = design.context.arm.torque_limit[rest.joint]
        removable = rest.structure - rest.flexible
        is_sure = rest.gain > max(LEFT_SURE, 2 * rest.error)
        is_material = removable > rest.rows * (MATERIAL * limit) ** 2
        if is_sure and is_material and removable > (1 - EXPLAINED) * (rest.nothing - rest.flexible):
            found.add(rest.joint)
        coloured = rest.excess > (COLOURED**2 - 1) * rest.white**2
        before, after = rest.outlying
        if rest.stage is Stage.DRIVE and after > max((1 - EXPLAINED) * before, rest.white**2, (MATERIAL * limit) ** 2):
            found.add(rest.joint)
        if rest.stage is Stage.DYNAMICS and coloured and rest.excess > (MATERIAL * limit) ** 2 and rest.removed < MOST:
            found.add(rest.joint)
    return tuple(sorted(found))


def _findings(search: Search, chosen: Structure, gap: Gap, seed: int, quick: bool) -> list[Finding]:
    design = search.design
    joints = design.context.arm.joints
    likely = probabilities(search, seed)
    found, named = [], set()
    for m in chosen.members:
        candidate = design.candidates[m]
        place = candidate.at(joints)
        effect, values = estimate(search, chosen, m, seed)
        named.add((effect.id, place))
        probability, inside = likely.get((effect.id, place), 0.0), larger(search, m)
        equivalent = () if quick else alternatives(search, chosen, m)
        found.append(
            Finding(
                effect,
                place,
                probability,
                values,
                gap.alone(search, m),
                equivalent,
                True,
                gap.removed(search, chosen, m),
                inside,
                sum(likely.get((name, place), 0.0) for name in inside),
            )
        )
    found += _steps(design)
    found.sort(key=lambda f: -f.energy)
    for (name, place), probability in sorted(likely.items(), key=lambda item: -item[1]):
        if (name, place) in named or probability < 0.02 or len(found) > 8 or not found:
            continue
        m = max(
            (n for n, c in enumerate(design.candidates) if c.effect.id == name and c.at(joints) == place),
            key=lambda n: search.value(search.structure((n,))),
        )
        if search.is_trifle(search.structure((m,)), m):
            continue
        effect, values = estimate(search, search.structure((m,)), m, seed, refined=False)
        found.append(Finding(effect, place, probability, values, gap.alone(search, m), (), False, 0.0))
    return found


def _steps(design: Design) -> list[Finding]:
    """Encoders that read in steps too coarse to be left out of a simulator."""
    context, found = design.context, []
    for j, step in enumerate(context.quanta):
        if step < COARSE:
            continue
        half = 0.01 * step
        values = {"step": Estimate(float(step), float(step - half), float(step + half), "rad")}
        energy = float(np.square(context.drive.stiffness[:, j].mean() * step) / 12) if context.drive else 0.0
        found.append(Finding(quantised(step), context.arm.joints[j], 1.0, values, 0.0, (), True, max(energy, 1e-9)))
    return found


def _verdict(found: list[Finding], unexplained: tuple[int, ...], rests: list[Rest], design: Design) -> str:
    """Of the whole: unexplained where most of what is predictable has no explanation."""
    chosen = [f for f in found if f.is_chosen]
    if unexplained:
        return "unexplained"
    if not chosen:
        return "no_gap"
    return "ambiguous" if any(f.is_open for f in chosen) else "identified"
