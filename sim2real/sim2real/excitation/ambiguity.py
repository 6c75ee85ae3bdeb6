"""What a recording leaves open: other models that explain it about as well as the chosen one."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from sim2real.diagnosis import Diagnosis
from sim2real.effects.catalogue import equivalence_classes
from sim2real.finding import Finding
from sim2real.inference.ranking import find_generalisations
from sim2real.inference.regression import RegressionProblem
from sim2real.inference.search import ModelSearch, ScoredModel
from sim2real.thresholds import THRESHOLDS

AMBIGUITY = THRESHOLDS.ambiguity


@dataclass(frozen=True, eq=False)
class Ambiguity:
    """Models that explain a recording about equally well."""

    models: tuple[ScoredModel, ...]
    """The chosen model, then its rivals."""
    names: tuple[tuple[str, ...], ...]
    """Ids of the effects that distinguish each model from the others."""
    joints: tuple[int, ...]
    """Numbers of the joints in which the models differ."""
    component: str
    """Component at which they differ."""


def find_open_question(diagnosis: Diagnosis) -> tuple[Finding, Ambiguity] | None:
    """The largest ambiguity of a diagnosis, and the finding that it is about; None where there is none."""
    search, chosen, joints = diagnosis.search, diagnosis.chosen, diagnosis.context.arm.joints
    for finding in diagnosis.findings:
        if not (finding.is_chosen and finding.is_open):
            continue
        member = next(
            (
                m
                for m in chosen.members
                if (c := search.design.candidates[m]).effect.id == finding.effect.id
                and c.component(joints) == finding.component
            ),
            None,
        )
        if member is None:
            continue
        likely = {
            f.effect.id
            for f in diagnosis.findings
            if not f.is_chosen and f.probability > 1 - THRESHOLDS.verdict.certain
        }
        question = find_ambiguity(search, chosen, member, likely.union(finding.competing_effects))
        if question is not None:
            return finding, question
    return None


def find_ambiguity(
    search: ModelSearch, chosen: ScoredModel, member: int, equivalent: Collection[str]
) -> Ambiguity | None:
    """The chosen model together with those in which something else stands in a member's place.

    equivalent: ids that may; where none of them comes near, whatever does. None where nothing does.
    """
    design, joints = search.design, search.design.context.arm.joints
    place = design.candidates[member].component(joints)
    remaining = tuple(m for m in chosen.members if m != member)
    inside = find_generalisations(search, member)  # no experiment can distinguish them from the member
    near = [
        (n,)
        for n in search.rank_candidates(search.model(remaining), THRESHOLDS.search.tried)
        if _can_replace(design, member, n) and design.candidates[n].effect.id not in inside
    ]
    found: dict[tuple[str, ...], ScoredModel] = {}
    for replaced, others in (((member,), near), *_find_sums(search, chosen, member)):
        kept = tuple(m for m in chosen.members if m not in replaced)
        for added in others:
            if any(_is_same_effect(design, n, m) for n in added for m in kept):
                continue
            model = search.model((*kept, *added))
            names = tuple(sorted(design.candidates[n].effect.id for n in added))
            if names not in found or search.value(model) > search.value(found[names]):
                found[names] = model
    found["nothing",] = search.model(remaining)
    mine = (design.candidates[member].effect.id,)
    found.pop(mine, None)
    near = {names: s for names, s in found.items() if search.value(s) > search.value(chosen) - AMBIGUITY.near}
    listed = {names: s for names, s in near.items() if len(names) == 1 and names[0] in equivalent}
    for name in sorted(set(equivalent).difference(*listed, inside)):  # it is no rival alone, but beside something else
        listed |= {n: s for n, s in _find_compound_rival(search, chosen, member, name).items() if n not in listed}
    found = listed | {n: s for n, s in near.items() if len(n) > 1} if listed else near
    ranked = sorted(found.items(), key=lambda item: -search.value(item[1]))[: AMBIGUITY.rivals]
    if not ranked:
        return None
    models = (chosen, *(s for _, s in ranked))
    differing = {m for s in models for m in s.members} - set.intersection(*(set(s.members) for s in models))
    touched = sorted({j for m in differing for j in joints_affected(search, m)})
    return Ambiguity(models, (mine, *(names for names, _ in ranked)), tuple(touched), place)


def joints_affected(search: ModelSearch, member: int) -> tuple[int, ...]:
    """Joints, by number, in which a member shows."""
    candidate = search.design.candidates[member]
    return search.joints_affected(candidate) if candidate.joint is None else (candidate.joint,)


def _find_compound_rival(
    search: ModelSearch, chosen: ScoredModel, member: int, name: str
) -> dict[tuple[str, ...], ScoredModel]:
    """The best model with the effect `name` at a member's place and without the member, where it comes
    near; called by all that it has and the chosen one has not. What it comes near without is left out: that
    explains something else, which the chosen model could have beside the member as well."""
    design, joints = search.design, search.design.context.arm.joints
    place = design.candidates[member].component(joints)
    least = search.value(chosen) - AMBIGUITY.near

    def stands_in(model: ScoredModel) -> bool:
        here = {c.effect.id for c in map(design.candidates.__getitem__, model.members) if c.component(joints) == place}
        return member not in model.members and name in here and search.value(model) > least

    found = [model for model in search.tried.values() if stands_in(model)]
    if not found:
        return {}
    best = max(found, key=search.value)
    for spare in sorted(set(best.members) - set(chosen.members)):
        less = search.model(tuple(m for m in best.members if m != spare))
        best = less if stands_in(less) else best
    added = set(best.members) - set(chosen.members)
    return {tuple(sorted(design.candidates[m].effect.id for m in added)): best}


def _can_replace(design: RegressionProblem, member: int, other: int) -> bool:
    """Whether a candidate could stand in a member's place: at its joint, or of the arm."""
    mine, its = design.candidates[member], design.candidates[other]
    return its.effect.id != mine.effect.id and (None in (its.joint, mine.joint) or its.joint == mine.joint)


def _find_sums(
    search: ModelSearch, chosen: ScoredModel, member: int
) -> Iterator[tuple[tuple[int, ...], list[tuple[int, ...]]]]:
    """(members replaced, what stands for them) where a class of effects has a sum, as "a + b"."""
    design = search.design
    mine = design.candidates[member]
    here = {design.candidates[m].effect.id: m for m in chosen.members if design.candidates[m].joint == mine.joint}
    by_id: dict[str, list[int]] = {}
    for n, c in enumerate(design.candidates):
        if c.joint == mine.joint:
            by_id.setdefault(c.effect.id, []).append(n)
    for members, _ in equivalence_classes():
        for text in (name for name in members if " + " in name):
            parts, single = text.split(" + "), [name for name in members if " + " not in name]
            if mine.effect.id in single and all(p in by_id for p in parts):
                yield (member,), [tuple(by_id[p][0] for p in parts)]
            elif mine.effect.id in parts and all(p in here for p in parts):
                yield tuple(here[p] for p in parts), [(by_id[s][0],) for s in single if s in by_id]


def _is_same_effect(design: RegressionProblem, one: int, other: int) -> bool:
    a, b = design.candidates[one], design.candidates[other]
    return one == other or (a.effect.id, a.joint, a.effect.component) == (
        b.effect.id,
        b.joint,
        b.effect.component,
    )
