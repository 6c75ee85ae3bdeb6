"""From recordings to the diagnosis: which effects explain the gap, how far they shrink it, and what stays unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arm.model import Arm, panda
from sim2real.checks.held_out import HeldOut, keep_what_helps, lay_aside
from sim2real.checks.lack_of_fit import LackOfFit, omnibus_test
from sim2real.checks.shrinkage import Gap, measure_gap
from sim2real.checks.unexplained import find_unexplained_joints
from sim2real.effects.evidence import Context
from sim2real.effects.sensing.encoder_quantisation import quantisation_regressor
from sim2real.finding import Finding
from sim2real.inference.context import make_context
from sim2real.inference.estimates import Estimate, estimate
from sim2real.inference.loop_delay import estimate_loop_delay
from sim2real.inference.nonlinear_refinement import refine_nonlinear_parameters
from sim2real.inference.ranking import effect_probabilities, find_competing_effects, find_generalisations
from sim2real.inference.regression import RegressionProblem, make_regression
from sim2real.inference.search import ModelSearch, ScoredModel
from sim2real.inference.torque_constants import refine_torque_constants
from sim2real.preparation import prepare_logs
from sim2real.progress import StageCallback, ignore_stage
from sim2real.recordings.excerpt import cut_excerpts
from sim2real.recordings.motor_current import current_to_torque
from sim2real.recordings.signals import Log
from sim2real.report.sentence import sentence
from sim2real.thresholds import THRESHOLDS

VERDICT = THRESHOLDS.verdict


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What the recordings show of the arm."""

    verdict: str
    """"no_gap", "identified", "ambiguous" (another effect may be the cause), "partly_explained" (effects are shown to help on
    held-out motion, and more is left) or "unexplained" (nothing is shown to help)."""
    findings: tuple[Finding, ...]
    """The effects of the chosen model, by the energy that they remove, then those of other probable models."""
    gap: Gap
    """The gap without effects and with the chosen model, each block predicted by a fit to the others; the effects were chosen
    on all of them."""
    held_out: HeldOut | None
    """The same on windows that neither fit nor choice has seen; None where none was laid aside."""
    lack_of_fit: tuple[LackOfFit, ...]
    """Omnibus tests of the chosen model, one a stage and joint."""
    unexplained: tuple[int, ...]
    """Numbers of the joints with a gap that no effect explains."""
    context: Context
    """The recordings and the nominal prediction of their motion."""
    design: RegressionProblem
    """The regression problem: blocks of rows, candidate effects, parameters."""
    search: ModelSearch
    """All models that were scored."""
    chosen: ScoredModel
    """The model that predicts held-out blocks best."""
    quick: bool = False
    """Whether single effects alone competed."""

    @property
    def sentence(self) -> str:
        """The result in one to three sentences."""
        joints = [self.context.arm.joints[j] for j in self.unexplained]
        left = {joint: self._left(j) for joint, j in zip(joints, self.unexplained)}
        return sentence(self.verdict, self.findings, left, self.gap, bool(self.context.reference), self.quick)

    def _left(self, joint: int) -> float:
        """RMS Nm that the model leaves at a joint, on held-out motion where there is any."""
        return float((self.gap if self.held_out is None else self.held_out).after_joint[joint])

    def summary(self) -> str:
        """The result as text for a terminal: the sentence, the gap, and one line an effect."""
        gap = self.gap
        lines = [self.sentence, f"gap {gap.before:.3g} -> {gap.after:.3g} Nm (repeatability {gap.floor:.3g} Nm)"]
        for finding in self.findings if self.verdict != "no_gap" else ():
            sizes = (f"{n} {e.value:.3g} [{e.low:.3g}, {e.high:.3g}] {e.unit}" for n, e in finding.parameters.items())
            mark = "" if finding.is_chosen else "(alternative) "
            name = f"{mark}{finding.effect.id} at {finding.component}"
            lines.append(f"{name}: p = {finding.class_probability:.2f}, {', '.join(sizes)}")
        return "\n".join(lines)


def diagnose(
    logs: Sequence[Log],
    arm: Arm | None = None,
    *,
    reference: Sequence[Log] = (),
    effort: str | None = None,
    quick: bool = False,
    seed: int = 0,
    tell: StageCallback = ignore_stage,
) -> Diagnosis:
    """Compare recordings of free motion with the nominal arm (None: the Panda with its hand).

    reference: earlier recordings of the same arm; then what changed since is explained, and the nominal arm need not be
    right. effort: which torque was measured (`preparation.prepare_logs`). quick: one effect at most, from excerpts. seed: of
    the bootstraps. tell: called with the name of each stage of `progress` that begins.
    Raises ContractViolation for recordings that cannot be what they claim, ValueError for ones that are too short.
    """
    logs, before, arm = prepare_logs(logs, arm or panda(), effort, reference)
    if quick:
        logs, before = (cut_excerpts(part) if part else part for part in (logs, before))
    return explain_gap(logs, arm, seed, quick, before, tell)


def explain_gap(
    logs: list[Log],
    arm: Arm | None = None,
    seed: int = 0,
    quick: bool = False,
    reference: Sequence[Log] = (),
    tell: StageCallback = ignore_stage,
) -> Diagnosis:
    """`diagnose` for logs that are prepared: torques of the drives, checked.

    quick: only single effects compete, and neither alternatives nor patterns in time are looked for. Raises ValueError
    where the logs are too short.
    """
    tell("search for effects")
    arm = arm or panda()
    laid_aside = () if quick else lay_aside([*reference, *logs], len(reference))
    known, constant = refine_torque_constants(list(reference or logs), arm)
    if reference:  # constants of motors are the same in both
        known += [log if log.per_ampere is None else current_to_torque(log, known[0].per_ampere) for log in logs]
        constant = None
    context = make_context(known, arm, len(reference), constant, laid_aside)
    design = estimate_loop_delay(make_regression(context))
    search = ModelSearch(design) if quick else ModelSearch(design).with_background()
    search, chosen = refine_nonlinear_parameters(search, search.run(*((1, 1) if quick else ())))
    chosen = chosen if quick else search.use_curves(chosen)
    chosen, held_out = keep_what_helps(search, chosen, seed)
    design = search.design
    tell("what is left, and how sure it is")
    lack_of_fit = omnibus_test(search, chosen.members)
    unexplained = find_unexplained_joints(search, chosen, lack_of_fit, quick)
    gap = measure_gap(search, chosen, seed)
    found = _findings(search, chosen, gap, held_out, seed, quick)
    return Diagnosis(
        _verdict(found, unexplained),
        tuple(found),
        gap,
        held_out,
        tuple(lack_of_fit),
        unexplained,
        context,
        design,
        search,
        chosen,
        quick,
    )


def _findings(
    search: ModelSearch, chosen: ScoredModel, gap: Gap, held_out: HeldOut | None, seed: int, quick: bool
) -> list[Finding]:
    design = search.design
    joints = design.context.arm.joints
    probability_of = effect_probabilities(search, seed)
    found, named = [], set()
    for m in chosen.members:
        candidate = design.candidates[m]
        place = candidate.component(joints)
        effect, values = estimate(search, chosen, m, seed)
        named.add((effect.id, place))
        probability = probability_of.get((effect.id, place), 0.0)
        generalised_by = find_generalisations(search, m)
        equivalent = () if quick else find_competing_effects(search, chosen, m)
        found.append(
            Finding(
                effect,
                place,
                probability,
                values,
                gap.shrink_alone(search, m),
                equivalent,
                True,
                gap.energy_removed(search, chosen, m),
                generalised_by,
                sum(probability_of.get((name, place), 0.0) for name in generalised_by),
                None if held_out is None else held_out.effects[m],
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
            (n for n, c in enumerate(design.candidates) if c.effect.id == name and c.component(joints) == place),
            key=lambda n: search.value(search.model((n,))),
        )
        if search.is_negligible(search.model((m,)), m):
            continue
        effect, values = estimate(search, search.model((m,)), m, seed, refined=False)
        found.append(Finding(effect, place, probability, values, gap.shrink_alone(search, m), (), False, 0.0))
    return found


def _steps(design: RegressionProblem) -> list[Finding]:
    """Encoders that read in steps too coarse to be left out of a simulator."""
    context, found = design.context, []
    for j, step in enumerate(context.quanta):
        if step < VERDICT.quantum:
            continue
        half = VERDICT.quantum_error * step
        values = {"step": Estimate(float(step), float(step - half), float(step + half), "rad")}
        energy = float(np.square(context.drive.stiffness[:, j].mean() * step) / 12) if context.drive else 0.0
        found.append(
            Finding(quantisation_regressor(step), context.arm.joints[j], 1.0, values, 0.0, (), True, max(energy, 1e-9))
        )
    return found


def _verdict(found: list[Finding], unexplained: tuple[int, ...]) -> str:
    """Of the whole: unexplained where any joint is, and nothing is shown to help."""
    chosen = [f for f in found if f.is_chosen]
    if unexplained:
        return "partly_explained" if any(f.is_shown_to_help for f in chosen) else "unexplained"
    if not chosen:
        return "no_gap"
    return "ambiguous" if any(f.is_open for f in chosen) else "identified"
