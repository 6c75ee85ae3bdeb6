"""Scoring reports against the key. The rules are written in benchmark/README.md, and nothing else is right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.catalogue import catalogue, equivalence_classes

from np_blind.arm.sampling.cases import UNKNOWN_FAULT_KIND
from np_common.intervals import wilson_interval

CLEAR = 3.0  # times its detection limit, from which on an effect must be named
REDUCIBLE = 0.2  # of the gap, which the true faults must remove for its share to mean something
HARM = 1.02  # times the gap before, beyond which a patch has done harm


@dataclass
class Score:
    """What is right about one case; None where the question does not arise. named: effect@component;
    effect: of faults of at least CLEAR; effect_any: of any size; found: of any size, wherever it stands in the report; settled: of `followup.is_settled`; settled_known: the same where the truth was one of the models
    that the experiment was to distinguish."""

    case: int
    kind: str
    truth: list[str]
    size: float
    verdict: str
    named: list[str]
    module: bool | None = None
    joint: bool | None = None
    effect: bool | None = None
    effect_any: bool | None = None
    false_alarm: bool | None = None
    abstained: bool | None = None
    pair: bool | None = None
    settled: bool | None = None
    settled_known: bool | None = None
    found: bool | None = None
    nothing_else: bool | None = None
    covered: list[bool] = field(default_factory=list)
    share: float | None = None
    absolute: float | None = None
    harm: bool | None = None
    error: str = ""
    runtime_s: float | None = None

    @property
    def possible(self) -> float | None:
        """Share of the held-out gap that the true faults remove; None where there is no share, or the patch has none of it."""
        return self.absolute / self.share if self.share else None

    @property
    def is_failure(self) -> bool:
        """Whether any score of the case is wrong."""
        wrong = (self.module, self.joint, self.effect, self.abstained, self.pair)
        return bool(self.error) or any(x is False for x in wrong) or bool(self.false_alarm) or bool(self.harm)


def modules() -> dict[str, str]:
    """Module of each effect."""
    return {name: entry["module"] for name, entry in catalogue().items()}


def classes() -> tuple[frozenset[str], ...]:
    """The pre-registered equivalence classes; a member may be a sum, "a + b"."""
    return tuple(members for members, _ in equivalence_classes())


def score_case(entry: Mapping, report: Mapping | None, error: str = "", has_friction: bool = False) -> Score:
    """One case of the key against its report; None, with what went wrong, where there is none.

    has_friction: of an arm with measured friction. A fault that is a law of friction too is then no effect of its own: nothing
    distinguishes it from the rest of its joint's friction, and neither it nor its interval is scored. Nor is it wrong to add one.
    """
    faults = entry["faults"]
    report = report or {"verdict": "none", "effects": [], "where": []}
    added = [e for e in report["effects"] if e.get("is_added", e["probability"] >= 0.5)]
    score = Score(
        entry["case"],
        entry["kind"],
        [f"{f['effect']}@{f['component']}" for f in faults],
        min((f["size"] for f in faults), default=0.0),
        report["verdict"],
        [f"{e['effect']}@{e['component']}" for e in added],
        error=error,
        runtime_s=report.get("runtime_s"),
    )
    friction = ("friction_curve", *ARM_EFFECTS["friction_curve"].special_cases) if has_friction else ()
    if entry["kind"] != UNKNOWN_FAULT_KIND:
        score.nothing_else = all(
            e["effect"] in friction or any(_is_named(fault, [e], added) for fault in faults) for e in added
        )
    if entry["kind"] == "friction":
        return score
    if entry["kind"] == "null":
        score.false_alarm = report["verdict"] != "no_gap"
    elif entry["kind"] == UNKNOWN_FAULT_KIND:
        score.abstained = report["verdict"] in ("unexplained", "partly_explained")
    elif entry["kind"] == "single":
        fault = faults[0]
        place = next((w for w in report["where"] if w["module"] != "unknown"), None)
        score.module = place is not None and place["module"] == modules()[fault["effect"]]
        score.joint = place is not None and place["component"] == fault["component"]
        score.effect_any = _is_named(fault, added[:1], added)
        score.effect = score.effect_any if fault["size"] >= CLEAR else None
        if fault["effect"] not in friction:
            score.found = _is_named(fault, added, added)
            score.covered = _coverage(fault, added)
    else:
        ranked = report["effects"][:3]
        score.pair = all(_is_named(fault, ranked, ranked) for fault in faults)
        score.covered = [hit for fault in faults for hit in _coverage(fault, added)]
    return score


def _is_named(fault: Mapping, effects: Sequence[Mapping], all_added: Sequence[Mapping]) -> bool:
    """Whether one of the effects is the fault, or a member of a pre-registered class, reported as one."""
    truth, place = fault["effect"], fault["component"]
    here = [e for e in effects if e["component"] == place]
    for effect in here:
        if effect["effect"] == truth:
            return True
        both = {truth, effect["effect"]}
        if truth in effect.get("equivalent_to", ()) and any(both <= members for members in classes()):
            return True
    names = {e["effect"] for e in all_added if e["component"] == place}
    sums = [set(member.split(" + ")) for c in classes() if truth in c for member in c if " + " in member]
    return bool(here) and any(parts <= names for parts in sums)


def _coverage(fault: Mapping, added: Sequence[Mapping]) -> list[bool]:
    """For each parameter that report and key share, whether the 95 % interval holds the truth."""
    for effect in added:
        if (effect["effect"], effect["component"]) == (fault["effect"], fault["component"]):
            return [
                interval["ci95"][0] <= fault["parameters"][name]["value"] <= interval["ci95"][1]
                for name, interval in effect["parameters"].items()
                if name in fault["parameters"]
            ]
    return []


def score_gap(score: Score, nominal: float, oracle: float, patched: float) -> None:
    """Put down how much of the held-out gap the patch removes; gaps in rad, of one case.

    Share against the oracle only where that removes at least REDUCIBLE of the gap; harm is judged always.
    """
    score.harm = bool(patched > HARM * nominal)
    if nominal - oracle >= REDUCIBLE * nominal and score.kind in ("single", "pair", "friction"):
        score.share = (nominal - patched) / (nominal - oracle)
        score.absolute = 1.0 - patched / nominal


def summary(scores: Sequence[Score]) -> dict[str, object]:
    """The figures that benchmark/README.md defines; each rate with `<name>_ci95` (Wilson) and `<name>_n`."""
    figures: dict[str, object] = {"cases": len(scores)}

    def rate(name: str, values: Sequence[bool | None]) -> None:
        known = [bool(v) for v in values if v is not None]
        figures[name] = round(sum(known) / len(known), 4) if known else None
        figures[f"{name}_ci95"] = [round(bound, 4) for bound in wilson_interval(sum(known), len(known))]
        figures[f"{name}_n"] = len(known)

    rate("module_accuracy", [s.module for s in scores])
    rate("joint_accuracy", [s.joint for s in scores])
    rate("effect_class_accuracy", [s.effect for s in scores])
    rate("effect_class_accuracy_any", [s.effect_any for s in scores])
    rate("planted_effect_found", [s.found for s in scores])
    rate("nothing_else_added", [s.nothing_else for s in scores])
    rate("false_alarm", [s.false_alarm for s in scores])
    rate("abstain_out_of_catalogue", [s.abstained for s in scores])
    rate("pairs_top3", [s.pair for s in scores])
    rate("settled_by_next", [s.settled for s in scores])
    rate("settled_where_known", [s.settled_known for s in scores])
    figures["ambiguous"] = sum(s.verdict == "ambiguous" for s in scores)
    rate("coverage95", [hit for s in scores for hit in s.covered])
    rate("harm", [s.harm for s in scores])
    clear = [s for s in scores if s.size >= CLEAR]
    rate("module_accuracy_clear", [s.module for s in clear])
    rate("joint_accuracy_clear", [s.joint for s in clear])
    figures["shrink_vs_oracle"] = median([s.share for s in scores])
    figures["shrink_vs_oracle_n"] = sum(s.share is not None for s in scores)
    figures["shrink_absolute"] = median([s.absolute for s in scores])
    figures["shrink_possible"] = median([s.possible for s in scores])
    times = [s.runtime_s for s in scores if s.runtime_s is not None]
    figures["runtime_median_s"] = round(float(np.median(times)), 1) if times else None
    figures["errors"] = sum(bool(s.error) for s in scores)
    return figures


def median(values: Sequence[float | None]) -> float | None:
    """Of those that are known, to four digits; None where none is."""
    known = [value for value in values if value is not None]
    return round(float(np.median(known)), 4) if known else None


def by_effect(scores: Sequence[Score]) -> dict[str, dict[str, int]]:
    """For every effect drawn alone, and every kind out of the catalogue: cases, clear ones, and what was right; intervals of
    its parameters, and how many of them held."""
    table: dict[str, dict[str, int]] = {}
    for s in scores:
        if s.kind not in ("single", UNKNOWN_FAULT_KIND):
            continue
        row = table.setdefault(
            s.truth[0].split("@")[0],
            dict.fromkeys(
                ("cases", "module", "joint", "clear", "named_when_clear", "abstained", "intervals", "held"), 0
            ),
        )
        row["cases"] += 1
        row["module"] += bool(s.module)
        row["joint"] += bool(s.joint)
        row["clear"] += s.effect is not None
        row["named_when_clear"] += bool(s.effect)
        row["abstained"] += bool(s.abstained)
        row["intervals"] += len(s.covered)
        row["held"] += sum(s.covered)
    return dict(sorted(table.items()))
