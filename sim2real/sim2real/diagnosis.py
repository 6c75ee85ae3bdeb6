"""From logs to the diagnosis: where the gap is, which effects explain it, how far they shrink it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arm.model import Arm, panda
from sim2real.checks.constancy import joints_with_play, slipped, unexplained_patterns
from sim2real.checks.omnibus import LackOfFit, omnibus_test
from sim2real.checks.shrinkage import Gap, measure
from sim2real.checks.standstill import ageing
from sim2real.effects.evidence import Context
from sim2real.effects.sensing.encoder_quantisation import quantised
from sim2real.effects.signature import Signature
from sim2real.effects.stage import Stage
from sim2real.inference.context import make_context
from sim2real.inference.design import Design, make_design
from sim2real.inference.estimates import Estimate, estimate
from sim2real.inference.gains import settled
from sim2real.inference.loop_delay import settle_delay
from sim2real.inference.ranking import alternatives, generalisations, probabilities
from sim2real.inference.search import Model, Search
from sim2real.inference.settling import settle_shapes
from sim2real.inference.visible import visible
from sim2real.progress import Tell, silent
from sim2real.recordings.current import as_torque
from sim2real.recordings.signals import Log
from sim2real.thresholds import THRESHOLDS

VERDICT = THRESHOLDS.verdict


@dataclass(frozen=True, eq=False)
class Finding:
    """An effect at a component (a joint, or "arm").

    parameters: by name; shrink: share by which the effect alone shrinks the held-out gap; equivalent_to: ids that
    these data cannot tell from it; is_chosen: whether it is of the chosen model; energy: mean square Nm^2 that it
    removes there. generalised_by: ids of effects of which it is a special case (`ranking.generalisations`), and which
    therefore do not contradict it; generalised_probability: theirs.
    """

    effect: Signature
    component: str
    probability: float
    parameters: dict[str, Estimate]
    shrink: float
    equivalent_to: tuple[str, ...]
    is_chosen: bool
    energy: float
    generalised_by: tuple[str, ...] = ()
    generalised_probability: float = 0.0

    @property
    def claimed(self) -> float:
        """Probability of what is claimed: this effect, or one of which it is a special case."""
        return min(1.0, self.probability + self.generalised_probability)

    @property
    def rivals(self) -> tuple[str, ...]:
        """Those of `equivalent_to` that contradict it."""
        return tuple(name for name in self.equivalent_to if name not in self.generalised_by)

    @property
    def is_open(self) -> bool:
        """Whether something else may as well be the cause."""
        return self.claimed < VERDICT.certain or bool(self.rivals)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The answer.

    findings: the chosen effects, then alternatives; lack_of_fit: of the omnibus test; unexplained: joints by number
    that have a gap without an explanation.
    """

    verdict: str
    findings: tuple[Finding, ...]
    gap: Gap
    lack_of_fit: tuple[LackOfFit, ...]
    unexplained: tuple[int, ...]
    context: Context
    design: Design
    search: Search
    chosen: Model


def diagnose(
    logs: list[Log],
    arm: Arm | None = None,
    seed: int = 0,
    quick: bool = False,
    reference: Sequence[Log] = (),
    tell: Tell = silent,
) -> Diagnosis:
    """Compare logs with the nominal arm (None: the Panda), or with what `reference` shows of the same arm: then what has
    changed since is explained, as changes against the arm as it was, and the nominal arm need not be right.

    quick: only single effects compete, and rivals and patterns in time are not looked for. tell: told which of the stages
    of `progress` begins. Raises ValueError where
    the logs are too short.
    """
    tell("search for effects")
    arm = arm or panda()
    known, constant = settled(list(reference or logs), arm)
    if reference:  # constants of motors are the same in both
        known += [log if log.per_ampere is None else as_torque(log, known[0].per_ampere) for log in logs]
        constant = None
    context = make_context(known, arm, len(reference), constant)
    design = settle_delay(make_design(context))
    search = Search(design)
    search, chosen = settle_shapes(search, search.run(*((1, 1) if quick else ())))
    design = search.design
    tell("what is left, and how sure it is")
    lack_of_fit = omnibus_test(search, chosen.members)
    suspect = [
        set(_lacking(lack_of_fit, design.context, joints_with_play(search, chosen.members))),
        _overexplained(search, chosen),
        _at_bounds(search, chosen),
        ageing(search, chosen.members),
    ]
    if not quick:
        suspect += [
            {m.joint for m in unexplained_patterns(search, chosen.members, lack_of_fit)},
            slipped(search, chosen.members),
        ]
    unexplained = tuple(sorted(set().union(*suspect)))
    gap = measure(search, chosen, seed)
    found = _findings(search, chosen, gap, seed, quick)
    return Diagnosis(
        _verdict(found, unexplained),
        tuple(found),
        gap,
        tuple(lack_of_fit),
        unexplained,
        context,
        design,
        search,
        chosen,
    )


def _overexplained(search: Search, chosen: Model) -> set[int]:
    """Joints that need more effects than `VERDICT.per_joint`, the arm's own included: so many can describe anything."""
    cells, count = search.design.cells, np.zeros(len(search.design.context.arm), int)
    before, after = np.array(search.energies(())), np.array(search.energies(chosen.members))
    for m in chosen.members:
        less = np.array(search.energies(tuple(n for n in chosen.members if n != m)))
        needed = {c.joint for c, b, a, rise in zip(cells, before, after, less) if rise - a > VERDICT.needed * b}
        count[list(needed)] += 1
    return set(np.flatnonzero(count > VERDICT.per_joint).tolist())


def _at_bounds(search: Search, chosen: Model) -> set[int]:
    """Joints at which a parameter, or a shape, is at its bound: the best fit is then no explanation."""
    found = set()
    for joints, inside in search.groups(chosen.members):
        ids, fitted = search.ids(joints, inside), search.group(joints, inside)[0].fit.parameters.mean(axis=0)
        for m in inside:
            candidate = search.design.candidates[m]
            places = [int(np.flatnonzero(ids == i)[0]) for i in candidate.ids]
            shape = candidate.effect.shape
            is_beyond = shape is not None and shape.value > shape.upper
            if is_beyond or any(
                abs(fitted[at]) > VERDICT.at_bound * search.design.parameters[i].upper
                for at, i in zip(places, candidate.ids)
                if search.design.parameters[i].name != "share"
            ):
                found |= set(search.reach(candidate)) if candidate.place is None else {candidate.place}
    return found


def _lacking(lack_of_fit: list[LackOfFit], context: Context, with_play: set[int]) -> tuple[int, ...]:
    """Joints at which the chosen model leaves more than noise.

    Either the flexible model predicts it, or it has a memory that the noise of a clean arm has not, or the drive
    now and then does what noise never does. A joint `with_play` turns its rotor alone across it, and then both: that is
    a memory, and explained.
    """
    found = set()
    for left in lack_of_fit:
        least = visible(context, left.stage, left.joint, VERDICT.torque)
        removable = left.chosen - left.flexible
        is_sure = left.gain > max(VERDICT.gain, VERDICT.gain_errors * left.error)
        is_material = removable > left.rows * least**2
        if is_sure and is_material and removable > (1 - VERDICT.explained) * (left.null - left.flexible):
            found.add(left.joint)
        coloured = left.excess > (VERDICT.coloured**2 - 1) * left.white**2
        before, after = left.outlying
        if left.stage is Stage.DRIVE and after > max((1 - VERDICT.explained) * before, left.white**2, least**2):
            found.add(left.joint)
        if (
            left.stage is Stage.DYNAMICS
            and left.joint not in with_play
            and coloured
            and left.excess > least**2
            and left.removed < VERDICT.coloured_explained
        ):
            found.add(left.joint)
    return tuple(sorted(found))


def _findings(search: Search, chosen: Model, gap: Gap, seed: int, quick: bool) -> list[Finding]:
    design = search.design
    joints = design.context.arm.joints
    probability_of = probabilities(search, seed)
    found, named = [], set()
    for m in chosen.members:
        candidate = design.candidates[m]
        place = candidate.at(joints)
        effect, values = estimate(search, chosen, m, seed)
        named.add((effect.id, place))
        probability = probability_of.get((effect.id, place), 0.0)
        generalised_by = generalisations(search, m)
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
                generalised_by,
                sum(probability_of.get((name, place), 0.0) for name in generalised_by),
            )
        )
    found += _steps(design)
    found.sort(key=lambda f: -f.energy)
    for (name, place), probability in sorted(probability_of.items(), key=lambda item: -item[1]):
        if (
            (name, place) in named
            or probability < VERDICT.listed_probability
            or len(found) > VERDICT.listed
            or not found
        ):
            continue
        m = max(
            (n for n, c in enumerate(design.candidates) if c.effect.id == name and c.at(joints) == place),
            key=lambda n: search.value(search.model((n,))),
        )
        if search.is_negligible(search.model((m,)), m):
            continue
        effect, values = estimate(search, search.model((m,)), m, seed, refined=False)
        found.append(Finding(effect, place, probability, values, gap.alone(search, m), (), False, 0.0))
    return found


def _steps(design: Design) -> list[Finding]:
    """Encoders that read in steps too coarse to be left out of a simulator."""
    context, found = design.context, []
    for j, step in enumerate(context.quanta):
        if step < VERDICT.quantum:
            continue
        half = VERDICT.quantum_error * step
        values = {"step": Estimate(float(step), float(step - half), float(step + half), "rad")}
        energy = float(np.square(context.drive.stiffness[:, j].mean() * step) / 12) if context.drive else 0.0
        found.append(Finding(quantised(step), context.arm.joints[j], 1.0, values, 0.0, (), True, max(energy, 1e-9)))
    return found


def _verdict(found: list[Finding], unexplained: tuple[int, ...]) -> str:
    """Of the whole: unexplained where any joint is."""
    chosen = [f for f in found if f.is_chosen]
    if unexplained:
        return "unexplained"
    if not chosen:
        return "no_gap"
    return "ambiguous" if any(f.is_open for f in chosen) else "identified"
