"""The result of a diagnosis of an arm in one to three sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from sim2real.checks.shrinkage import Gap
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.effect import EffectTarget
from sim2real.effects.joint_dynamics.friction_curve import EFFECT as CURVE
from sim2real.effects.sentences import ValueWithInterval, describe_component, describe_effect
from sim2real.finding import Finding

NAMED = 3
"""Findings that a headline names; it counts the others."""
_COUNT = {1: "it", 2: "both", 3: "all three"}
_CURVES = 3  # friction curves from which on each has one number here; all their values are in the report


def sentence(
    verdict: str,
    findings: Sequence[Finding],
    left: Mapping[str, float],
    gap: Gap,
    is_change: bool = False,
    quick: bool = False,
) -> str:
    """What differs and by how much, which effects compete, and what is left (`left` Nm RMS) at joints that no effect explains.

    is_change: whether the comparison is with earlier recordings of the arm, not with the simulator. quick: whether sets of effects
    were not tried.
    """
    nominal = "the arm as it was" if is_change else "the simulator"
    found = [f for f in findings if f.is_chosen]
    if verdict == "no_gap":
        text = "The arm moves as it did" if is_change else "The arm moves as the simulator does"
        return f"{text}: no difference was found that repeats."
    parts = [_describe_unexplained(left, nominal, quick)] if verdict == "unexplained" else []
    if verdict == "partly_explained":
        parts.append(_describe_partly_explained(sum(f.is_shown_to_help for f in found), left))
    if found:
        clauses = list(_describe_found(found, nominal))
        text = "; ".join(clause for clause, _ in clauses[:NAMED])
        if more := sum(count for _, count in clauses[NAMED:]):
            text += f"; and {more} more, see the report's table"
        text = text.replace("(", "(95 %: ", 1)  # the other brackets are the same
        opening = {
            "unexplained": "What was found beside that: ",
            "partly_explained": "Found: ",
            "ambiguous": "Probably ",
        }.get(verdict, "")
        parts.append(f"{opening}{text}.")
        parts.append(_describe_shrinkage(gap, len(found)))
    doubtful = [f for f in found if verdict == "ambiguous" and f.is_open]
    parts += [_describe_doubt(f) for f in doubtful[:NAMED]]
    if more := len(doubtful[NAMED:]):
        parts.append(f"{more} more {'is' if more == 1 else 'are'} not sure either.")
    return " ".join(part[0].upper() + part[1:] for part in parts)


def _describe_found(found: Sequence[Finding], nominal: str) -> Iterator[tuple[str, int]]:
    """Half a sentence for each finding, one for all friction curves where there are many; with the number of findings in it."""
    curves = [f for f in found if f.effect.id == CURVE.id]
    if len(curves) < _CURVES:
        curves = []
    for finding in found:
        if finding not in curves:
            yield _describe_finding(finding, nominal), 1
        elif finding is curves[0]:
            yield _describe_curves(curves), len(curves)


def _describe_curves(curves: Sequence[Finding]) -> str:
    most = [f"{_largest_sure(f):.2g} Nm at {describe_component(EffectTarget.JOINT, f.component)}" for f in curves]
    return f"{len(curves)} joints have other friction curves: they differ by up to {_join(most)}"


def _largest_sure(finding: Finding) -> float:
    """Size of the largest value whose interval does not hold 0; of the largest at all where there is none."""
    sure = [e for e in finding.parameters.values() if e.low * e.high > 0]
    return max(abs(e.value) for e in sure or finding.parameters.values())


def _describe_finding(finding: Finding, nominal: str) -> str:
    values = {name: ValueWithInterval(e.value, e.low, e.high) for name, e in finding.parameters.items()}
    return describe_effect(ARM_EFFECTS[finding.effect.id], finding.component, values, nominal)


def _describe_shrinkage(gap: Gap, count: int) -> str:
    share, low, high = (round(100 * share) for share in (gap.shrink, *gap.shrink_interval))
    what = _COUNT.get(count, f"all {count}")
    return f"Adding {what} removes {share} % of the gap (95 %: {low} to {high})."


def _describe_doubt(finding: Finding) -> str:
    """Why a finding is not sure."""
    name = f"{_effect_name(finding.effect.id)} at {describe_component(EffectTarget.JOINT, finding.component)}"
    if finding.competing_effects:
        return f"{name} cannot be distinguished from {' or '.join(map(_effect_name, finding.competing_effects))} by these recordings."
    return f"{name} has a probability of {finding.class_probability:.2f} only."


def _describe_partly_explained(count: int, left: Mapping[str, float]) -> str:
    """Both halves: what is explained, and what is left where."""
    rest = _join([f"{value:.2g} Nm at {describe_component(EffectTarget.JOINT, name)}" for name, value in left.items()])
    effects = "one effect is" if count == 1 else f"{count} effects are"
    return f"The difference is partly explained: {effects} shown to help on held-out motion, and {rest} is left that no known effect explains."


def _join(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _describe_unexplained(left: Mapping[str, float], nominal: str, quick: bool) -> str:
    names = _join([describe_component(EffectTarget.JOINT, name) for name in left])
    verb = "departs" if len(left) == 1 else "depart"
    if quick:
        return f"{names} {verb} from {nominal} in a way that no single effect explains: without --quick sets of effects are tried."
    return f"{names} {verb} from {nominal} in a way that no known effect explains: look at the joint before you use the patch."


def _effect_name(effect: str) -> str:
    return effect.replace("_", " ")
